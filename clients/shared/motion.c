#include "shared/motion.h"

#include <stddef.h>
#include <string.h>

/* At MOTION_START, a 200 mm needle has its tip 1 mm in front of the skin, which is at z = 0 in the supplied scenes. */
static const motion scripts[] = {
    {"figure8", "push in, move the base up, pull back: figure 8 of the paper", 2.4, 2.8, 4,
     {{0.0, 1.3, {0, 0, 0.066}, {0, 0, 0}},
      {1.3, 1.6, {0, 0.010, 0}, {0, 0, 0}},
      {1.4, 2.1, {0, 0, -0.066}, {0, 0, 0}},
      {2.4, 2.7, {0, -0.010, 0}, {0, 0, 0}}}},
    {"hold", "stay where it starts", 2.0, 2.0, 0, {{0, 0, {0, 0, 0}, {0, 0, 0}}}},
    {"insert", "push in and pull back along the axis", 3.0, 3.0, 2,
     {{0.0, 1.3, {0, 0, 0.066}, {0, 0, 0}},
      {1.6, 2.9, {0, 0, -0.066}, {0, 0, 0}}}},
    {"sweep", "push in, move the base round a square, pull back", 5.0, 5.0, 7,
     {{0.0, 1.3, {0, 0, 0.066}, {0, 0, 0}},
      {1.5, 2.0, {0.005, 0.005, 0}, {0, 0, 0}},
      {2.0, 2.4, {-0.010, 0, 0}, {0, 0, 0}},
      {2.4, 2.8, {0, -0.010, 0}, {0, 0, 0}},
      {2.8, 3.2, {0.010, 0, 0}, {0, 0, 0}},
      {3.2, 3.6, {-0.005, 0.005, 0}, {0, 0, 0}},
      {3.7, 4.9, {0, 0, -0.066}, {0, 0, 0}}}},
    {"roll", "push in half way, turn the bevel over, push on, turn back, pull back", 4.0, 4.0, 5,
     {{0.0, 0.7, {0, 0, 0.034}, {0, 0, 0}},
      {0.8, 1.4, {0, 0, 0}, {0, 0, 3.141592653589793}},
      {1.5, 2.1, {0, 0, 0.032}, {0, 0, 0}},
      {2.2, 2.8, {0, 0, 0}, {0, 0, -3.141592653589793}},
      {2.9, 3.9, {0, 0, -0.066}, {0, 0, 0}}}},
    {"again", "push in and pull back twice, at places 8 mm apart", 5.4, 5.8, 6,
     {{0.0, 1.2, {0, 0, 0.066}, {0, 0, 0}},
      {1.3, 2.4, {0, 0, -0.066}, {0, 0, 0}},
      {2.5, 2.9, {-0.008, 0, 0}, {0, 0, 0}},
      {3.0, 4.2, {0, 0, 0.066}, {0, 0, 0}},
      {4.3, 5.4, {0, 0, -0.066}, {0, 0, 0}},
      {5.4, 5.8, {0.008, 0, 0}, {0, 0, 0}}}},
};

const motion *motion_at(int index) {
    return index >= 0 && index < (int)(sizeof scripts / sizeof *scripts) ? &scripts[index] : NULL;
}

const motion *motion_find(const char *name) {
    for (int i = 0; motion_at(i); i++)
        if (strcmp(scripts[i].name, name) == 0) return &scripts[i];
    return NULL;
}

motion motion_to_depth(const motion *script, double depth) {
    motion deep = *script;
    double factor = depth / MOTION_DEPTH;
    deep.duration *= factor;
    deep.period *= factor;
    for (int i = 0; i < deep.leg_count; i++) {
        deep.legs[i].from *= factor;
        deep.legs[i].to *= factor;
        deep.legs[i].shift.z *= factor;
    }
    return deep;
}

double motion_fraction(double from, double to, double t) {
    if (t <= from) return 0;
    if (t >= to) return 1;
    double x = (t - from) / (to - from);
    return x * x * x * (10.0 + x * (-15.0 + 6.0 * x));
}

pose motion_pose(const motion *script, pose start, double t) {
    if (t > script->period) t = fmod(t, script->period);
    pose p = start;      /* shifts are along the needle's initial axes */
    for (int i = 0; i < script->leg_count; i++) {
        const motion_leg *leg = &script->legs[i];
        double fraction = motion_fraction(leg->from, leg->to, t);
        p.position = v3_axpy(fraction, q_rotate(start.orientation, leg->shift), p.position);
        p.orientation = q_multiply(p.orientation, q_exp(v3_scale(fraction, leg->turn)));
    }
    return p;
}
