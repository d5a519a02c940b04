/* Stability and passivity margins of a haptic loop in which a hand holds a device, and a sampled, delayed virtual coupling presses the device against a rigid
   wall. The stability margin tells how far the loop is from oscillating, the passivity margin how far it is from feeding energy to a hand. A rigid wall is the
   worst case: tissue acts as a spring in series with the coupling. */
#ifndef TROCAR_LOOP_MARGIN_H
#define TROCAR_LOOP_MARGIN_H

enum { LOOP_MAX_DELAY = 4096 };

typedef struct {
    double mass, damping, stiffness; /* kg, N s/m, N/m: of device and hand together, as in hand.h; damping may be 0 */
    double coupling_stiffness, coupling_damping; /* N/m, N s/m: at the hand */
    double period;           /* s, sampling period of the position; the force is constant for one period */
    int delay;               /* periods between taking a sample and first applying the force computed from it, 0 to LOOP_MAX_DELAY */
} haptic_loop;

/* Returns the smallest damping b (N s/m) of the device that makes device and coupling passive, and therefore stable with every passive hand:

       b > sup over w of  (T / 2) / (1 - cos wT)  Re{ (1 - exp(-jwT)) H(exp(jwT)) },  0 < w <= pi / T,

   with H(z) = z^-d (K + B (1 - 1/z) / T) (Colgate and Schenkel 1997, J. Robotic Systems 14(1):37-47); without delay this is K T / 2 + B. Writes the
   frequency (Hz) at which the supremum occurs. */
double loop_required_damping(const haptic_loop *loop, double *frequency);

/* Returns the gain margin: the smallest factor by which coupling_stiffness and coupling_damping can be multiplied for the loop with this hand to oscillate. By
   Nyquist's criterion, it is the smallest g > 0 with 1 + g P(z) H(z) = 0 on the unit circle, where P is the exact response of hand and device to a force that
   is constant for each period. Writes the frequency of the oscillation (Hz). INFINITY if there is none. */
double loop_gain_margin(const haptic_loop *loop, double *frequency);

/* Finds the gain margin, between 1e-6 and 1e6, by simulating the hand's motion after an impulse instead of by Nyquist's criterion. */
double loop_simulated_margin(const haptic_loop *loop);

/* Limits on the force, and the device's resolution. */
typedef struct {
    double max_force, max_force_rate; /* N, N/s */
    double resolution;       /* m */
} loop_limits;

/* Result of a push, in which the hand's target moves at 0.1 m/s from 1 mm in front of a wall to 10 mm behind it, and stays there for 5 s. */
typedef struct {
    double rest_time;        /* s after the end of the push from which the hand's motion stays below 0.5 mm; INFINITY if it never does */
    double force;            /* N, maximum magnitude */
    double energy;           /* J, peak net energy that the force has supplied to hand and device */
} loop_push_result;

loop_push_result loop_push(const haptic_loop *loop, const loop_limits *limits);

#endif
