/* The computations behind needle.c, vectorised over four segments. */
#ifndef TROCAR_ROD_KERNELS_H
#define TROCAR_ROD_KERNELS_H

#include <string.h>

#include "needle/needle_model.h"

enum { ROD_STEP = 4 };       /* number of segments computed at a time */

/* Orientations of the base and the segments. The last one is repeated to fill up a SIMD vector. */
typedef struct {
    quat base_and_segments[1 + NEEDLE_PLACES];
} rod_frames;

static inline quat *rod_frame(rod_frames *of, int segment) { return &of->base_and_segments[1 + segment]; }
static inline void rod_copy_frames(int n, const needle_state *state, rod_frames *to) {
    to->base_and_segments[0] = state->base.orientation;
    memcpy(rod_frame(to, 0), state->frames, (size_t)n * sizeof *state->frames);
    for (int k = n; k < n + ROD_STEP; k++) *rod_frame(to, k) = state->frames[n - 1];
}

/* Returns the length of needle whose bending is lumped into joint k, the one before segment k: half a segment at the base, one segment elsewhere. */
static inline double rod_joint_length(const needle_model *model, int k) { return (k == 0 ? 0.5 : 1.0) * model->segment_length; }

/* Sets the orientations of the base and the segments, and recomputes the joint positions. RT */
void rod_set_frames(const needle_model *model, const rod_frames *of, needle_state *state);

/* These implement the needle_* functions of the same name in needle.h. rod_extrapolate continues a motion by `fraction` of its duration. RT */
vec3 rod_root_moment(const needle_model *model, const needle_state *state);
void rod_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);
double rod_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);
void rod_extrapolate(const needle_model *model, const needle_motion *motion, double fraction, needle_state *state);

#endif
