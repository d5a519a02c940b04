/* Stability and passivity margins of a haptic loop: a hand holds a device, whose sampled and delayed virtual coupling presses against a rigid wall.
   The stability margin is the distance from oscillation, the passivity margin that from feeding energy to a hand. The wall is the worst case, because
   tissue is a spring in series with the coupling. */
#ifndef TROCAR_LOOP_MARGIN_H
#define TROCAR_LOOP_MARGIN_H

enum { LOOP_MAX_DELAY = 4096 };

typedef struct {
    double mass, damping, stiffness; /* kg, N s/m, N/m: of device and hand together, as in hand.h; damping may be 0 */
    double coupling_stiffness, coupling_damping; /* N/m, N s/m: at the hand */
    double period;           /* s, sampling period of the position; the force is held constant for one period */
    int delay;               /* number of periods between a sample and the start of its force, from 0 to LOOP_MAX_DELAY */
} haptic_loop;

/* Returns the smallest damping (N s/m) of the device at which device and coupling are passive, and therefore stable with every passive hand:

       b > sup over w of  (T / 2) / (1 - cos wT)  Re{ (1 - exp(-jwT)) H(exp(jwT)) },  0 < w <= pi / T,

   with H(z) = z^-d (K + B (1 - 1/z) / T) (Colgate and Schenkel 1997, J. Robotic Systems 14(1):37-47); without delay this is K T / 2 + B. Stores the
   frequency (Hz) of the supremum. */
double loop_required_damping(const haptic_loop *loop, double *frequency);

/* Returns the gain margin: the smallest factor of coupling_stiffness and coupling_damping at which the loop with this hand oscillates. By Nyquist's criterion,
   it is the smallest g > 0 with 1 + g P(z) H(z) = 0 on the unit circle, where P is the exact response of hand and device to a force that is constant for each
   period. Stores the frequency (Hz) of the oscillation. INFINITY if there is none. */
double loop_gain_margin(const haptic_loop *loop, double *frequency);

/* Finds the gain margin by simulating the hand's motion after an impulse, instead of by Nyquist's criterion. Searches between 1e-6 and 1e6. */
double loop_simulated_margin(const haptic_loop *loop);

/* Limits of the force on the hand, and the resolution of the device. */
typedef struct {
    double max_force, max_force_rate; /* N, N/s */
    double resolution;       /* m */
} loop_limits;

/* Result of a push: the hand's target moves at 0.1 m/s from 1 mm in front of a wall to 10 mm behind it, and then stays there for 5 s. */
typedef struct {
    double rest_time;        /* s from the end of the push until the hand's motion stays below 0.5 mm; INFINITY if it does not come to rest */
    double force;            /* N, maximum magnitude */
    double energy;           /* J, maximum over time of the net energy that the force has supplied to hand and device since contact */
} loop_push_result;

loop_push_result loop_push(const haptic_loop *loop, const loop_limits *limits);

#endif
