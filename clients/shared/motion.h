/* Scripted motions of the needle's base. They are pure functions of time, so a device and a log use the same poses. */
#ifndef TROCAR_MOTION_H
#define TROCAR_MOTION_H

#include "base/vec.h"

/* One leg of a motion: between two times, the base moves by `shift` and rotates by `turn` along a minimum-jerk profile, as a hand does. If legs overlap, their
   shifts are added and their turns are multiplied in order. */
typedef struct {
    double from, to;         /* s */
    vec3 shift;              /* m, in the needle's initial frame, whose z is the needle's axis */
    vec3 turn;               /* rad, rotation vector in the needle's frame, about the base point */
} motion_leg;

#define MOTION_START ((pose){{0.005, 0.003, -0.201}, {1, 0, 0, 0}}) /* puts the tip of a 200 mm needle 1 mm in front of the skin */

#define MOTION_DEPTH 0.066 /* m, how far the scripts insert the needle from MOTION_START */

enum { MOTION_MAX_LEGS = 8 };

typedef struct {
    const char *name, *summary;
    double duration;         /* s, of one run of the script */
    double period;           /* s, at least `duration`: when the motion is back at its start and can be repeated */
    int leg_count;
    motion_leg legs[MOTION_MAX_LEGS];
} motion;

/* Returns the script with this name, or NULL. */
const motion *motion_find(const char *name);

/* Returns the script with this index, or NULL after the last. */
const motion *motion_at(int index);

/* Returns a script that advances the needle by this depth (m) instead of MOTION_DEPTH, at the same speed along the needle. Scales all times by the same factor,
   so sideways legs and turns become slower in a deeper script, and faster in a shallower one. */
motion motion_to_depth(const motion *script, double depth);

/* Returns how much of a leg is complete at time t: 0 before `from`, 1 after `to`, with minimum jerk in between, 10 x^3 - 15 x^4 + 6 x^5 (Flash and Hogan
   1985). */
double motion_fraction(double from, double to, double t);

/* Returns the pose at time `t` (s) of a script that starts at `start`. The needle rests before t = 0, and the script repeats after its period. */
pose motion_pose(const motion *script, pose start, double t);

#endif
