/* Scripted motions of the needle's base: pure functions of time, so that a device and a log play the same poses. */
#ifndef TROCAR_MOTION_H
#define TROCAR_MOTION_H

#include "base/vec.h"

/* One move of the base: between two times it moves by `shift` and rotates by `turn` with minimum jerk, like a hand. Legs may
   overlap: their shifts add, their turns multiply in order. */
typedef struct {
    double from, to;         /* s */
    vec3 shift;              /* m, in the needle's frame at the start: z is its axis */
    vec3 turn;               /* rad, rotation vector in the needle's frame, about the base point */
} motion_leg;

#define MOTION_START ((pose){{0.005, 0.003, -0.201}, {1, 0, 0, 0}}) /* the tip of a 200 mm needle is then 1 mm before the skin */

#define MOTION_DEPTH 0.066 /* m that the scripts insert the needle, from there */

enum { MOTION_MAX_LEGS = 8 };

typedef struct {
    const char *name, *summary;
    double duration;         /* s, of one play */
    double period;           /* s >= duration: the time at which the motion is back at its start and can be repeated */
    int leg_count;
    motion_leg legs[MOTION_MAX_LEGS];
} motion;

/* The script of this name, or NULL. */
const motion *motion_find(const char *name);

/* All scripts in order, NULL after the last. */
const motion *motion_at(int index);

/* A script that inserts the needle by this depth (m) instead of MOTION_DEPTH, at the same speed along the needle. All times scale in proportion:
   sideways legs and turns are slower in a deeper script, and faster in a shallower one. */
motion motion_to_depth(const motion *script, double depth);

/* Fraction of a leg done at time t, 0 before `from` and 1 after `to`: minimum jerk, 10 x^3 - 15 x^4 + 6 x^5
   (Flash and Hogan 1985). */
double motion_fraction(double from, double to, double t);

/* Pose at `t` (s; before 0: at rest at `start`; after the period: repeated) of a script that starts at `start`. */
pose motion_pose(const motion *script, pose start, double t);

#endif
