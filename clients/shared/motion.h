/* Scripted motions of the needle's base. They are pure functions of time, so that a device and a log use the same poses. */
#ifndef TROCAR_MOTION_H
#define TROCAR_MOTION_H

#include "base/vec.h"

/* One leg of a motion: between two times, the base moves by `shift` and rotates by `turn` with minimum jerk, as a hand does. Legs may overlap: their
   shifts are added, and their turns are multiplied in order. */
typedef struct {
    double from, to;         /* s */
    vec3 shift;              /* m, in the needle's frame at the start, whose z is the needle's axis */
    vec3 turn;               /* rad, rotation vector in the needle's frame, about the base point */
} motion_leg;

#define MOTION_START ((pose){{0.005, 0.003, -0.201}, {1, 0, 0, 0}}) /* the tip of a 200 mm needle is then 1 mm in front of the skin */

#define MOTION_DEPTH 0.066 /* m, depth to which the scripts insert the needle from MOTION_START */

enum { MOTION_MAX_LEGS = 8 };

typedef struct {
    const char *name, *summary;
    double duration;         /* s, duration of one play */
    double period;           /* s, at least `duration`: time after which the motion is back at its start and can be repeated */
    int leg_count;
    motion_leg legs[MOTION_MAX_LEGS];
} motion;

/* Returns the script with this name, or NULL. */
const motion *motion_find(const char *name);

/* Returns the script with this index, or NULL after the last. */
const motion *motion_at(int index);

/* Returns a script that advances the needle by this depth (m) instead of MOTION_DEPTH, at the same speed along the needle. All times are scaled by the
   same factor, so sideways legs and turns are slower in a deeper script, and faster in a shallower one. */
motion motion_to_depth(const motion *script, double depth);

/* Returns the fraction of a leg completed at time t, 0 before `from` and 1 after `to`: minimum jerk, 10 x^3 - 15 x^4
   + 6 x^5 (Flash and Hogan 1985). */
double motion_fraction(double from, double to, double t);

/* Returns the pose at time `t` (s) of a script that starts at `start`: at rest before t = 0, and repeated after the period. */
pose motion_pose(const motion *script, pose start, double t);

#endif
