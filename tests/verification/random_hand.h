/* Random hand motions for the smoothness check: realistic insertions with steering, retraction and reinsertion. They consist of minimum-jerk moves from rest
   to rest, at no more than 50 mm/s along the needle. Steering, during which the tissue may stick to the needle, is limited to 30 mm/s: at depth the
   stiffness is 1.2 N/mm, which at 50 mm/s would give 0.06 N per tick. */
#ifndef TROCAR_VERIFICATION_RANDOM_HAND_H
#define TROCAR_VERIFICATION_RANDOM_HAND_H

#include <stdlib.h>

#include "shared/motion.h"

static const double PEAK_OF_MEAN = 1.875;    /* peak speed over mean speed in a minimum-jerk move */
static const double NEEDLE_LENGTH = 0.2;     /* m, length of the scene's needle */
static const double FASTEST = 0.05, FASTEST_STEERING = 0.03; /* m/s */
static const double FASTEST_ROLL = 6.0;      /* rad/s */
static const double DEEPEST = 0.085;         /* m, largest depth of the tip below the skin */

/* One move from rest to rest. Unused components are zero. */
typedef struct {
    double seconds;
    double advance;          /* m, along the needle */
    vec3 sideways;           /* m, of the base, across the needle */
    double roll;             /* rad */
    vec3 tilt;               /* rad, rotation about the entry point */
} hand_leg;

enum { HAND_MAX_LEGS = 24 };

typedef struct {
    pose start;              /* tip 1 mm in front of the skin */
    double bevel_slope;
    int leg_count;
    hand_leg legs[HAND_MAX_LEGS];
} random_hand;

static inline double hand_uniform(unsigned *seed, double low, double high) { return low + (high - low) * rand_r(seed) / RAND_MAX; }

/* Adds a leg long enough to keep each component below its maximum speed. */
static inline void hand_add(random_hand *hand, unsigned *seed, double fastest, hand_leg leg) {
    double speed = hand_uniform(seed, 0.01, fastest), mean = 0.0;
    mean = fmax(mean, fabs(leg.advance) / speed);
    mean = fmax(mean, v3_norm(leg.sideways) / speed);
    mean = fmax(mean, fabs(leg.roll) / FASTEST_ROLL);
    mean = fmax(mean, v3_norm(leg.tilt) * NEEDLE_LENGTH / speed);
    leg.seconds = fmax(0.1, PEAK_OF_MEAN * mean);
    if (hand->leg_count < HAND_MAX_LEGS) hand->legs[hand->leg_count++] = leg;
}

static inline bool hand_chance(unsigned *seed, double probability) { return hand_uniform(seed, 0, 1) < probability; }

/* Adds a random combination of motions while the needle is in the tissue. */
static inline hand_leg hand_steer(unsigned *seed, double depth) {
    hand_leg leg = {0};
    if (hand_chance(seed, 0.7)) leg.advance = fmax(fmin(hand_uniform(seed, -0.025, 0.035), DEEPEST - depth), -0.9 * depth);
    if (hand_chance(seed, 0.5)) leg.sideways = v3(hand_uniform(seed, -0.004, 0.004), hand_uniform(seed, -0.004, 0.004), 0);
    if (hand_chance(seed, 0.4)) leg.roll = hand_uniform(seed, -M_PI, M_PI);
    if (hand_chance(seed, 0.3)) leg.tilt = v3(hand_uniform(seed, -0.03, 0.03), hand_uniform(seed, -0.03, 0.03), 0);
    return leg;
}

static inline void hand_insert_and_withdraw(random_hand *hand, unsigned *seed, int moves) {
    double depth = hand_uniform(seed, 0.01, 0.05);
    hand_add(hand, seed, FASTEST, (hand_leg){.advance = 0.001 + depth, .roll = hand_chance(seed, 0.3) ? hand_uniform(seed, -M_PI, M_PI) : 0.0});
    for (int i = 0; i < moves; i++) {
        hand_leg leg = hand_steer(seed, depth);
        depth += leg.advance;
        hand_add(hand, seed, FASTEST_STEERING, leg);
    }
    hand_add(hand, seed, FASTEST, (hand_leg){.advance = -depth - 0.004});
}

/* Returns an insertion, followed by steering, a withdrawal, and an insertion at the same point or close to it. */
static inline random_hand random_hand_create(unsigned seed) {
    random_hand hand = {.bevel_slope = hand_chance(&seed, 0.5) ? hand_uniform(&seed, 0.0, 0.1) : 0.0};
    vec3 entry = v3(hand_uniform(&seed, -0.02, 0.02), hand_uniform(&seed, -0.015, 0.015), 0);
    quat lean = q_exp(v3(hand_uniform(&seed, -0.1, 0.1), hand_uniform(&seed, -0.1, 0.1), 0));
    quat roll = q_exp(v3(0, 0, hand_uniform(&seed, -M_PI, M_PI)));
    hand.start = (pose){v3_axpy(-0.201, q_rotate(lean, v3(0, 0, 1)), entry), q_multiply(lean, roll)};
    hand_insert_and_withdraw(&hand, &seed, 8);
    hand_leg aside = {.advance = 0.003};
    if (hand_chance(&seed, 0.6)) aside.sideways = v3(hand_uniform(&seed, -0.005, 0.005), hand_uniform(&seed, -0.005, 0.005), 0);
    hand_add(&hand, &seed, FASTEST, aside);
    hand_insert_and_withdraw(&hand, &seed, 4);
    return hand;
}

/* Returns one insertion in two moves that take a few seconds. */
static inline random_hand random_hand_brief(unsigned seed) {
    random_hand whole = random_hand_create(seed), hand = {.start = whole.start, .bevel_slope = whole.bevel_slope};
    seed += 1000;
    hand_insert_and_withdraw(&hand, &seed, 2);
    return hand;
}

/* Returns the pose at time t of a leg that started at `from`. A tilt rotates the needle about the point `free_length` from the base. */
static inline pose hand_pose(const hand_leg *leg, pose from, double free_length, double t) {
    double f = motion_fraction(0.0, leg->seconds, t);
    vec3 pivot = v3_axpy(free_length, q_rotate(from.orientation, v3(0, 0, 1)), from.position);
    quat tilt = q_exp(v3_scale(f, q_rotate(from.orientation, leg->tilt)));
    pose p = {v3_add(pivot, q_rotate(tilt, v3_sub(from.position, pivot))), q_multiply(tilt, from.orientation)};
    vec3 way = q_rotate(p.orientation, v3_scale(f, v3(leg->sideways.x, leg->sideways.y, leg->advance)));
    p.position = v3_add(p.position, way);
    p.orientation = q_unit(q_multiply(p.orientation, q_exp(v3(0, 0, f * leg->roll))));
    return p;
}

#endif
