/* Symmetric tensors in the plane across a needle's track. */
#ifndef TROCAR_PLANE_TENSOR_H
#define TROCAR_PLANE_TENSOR_H

#include "base/vec.h"

/* Components along the first two axes of frame_along(), called with the track's direction. */
typedef struct {
    double xx, xy, yy;
} plane_tensor;

/* A tensor that has the value `least` in all directions, plus `more` along the unit vector `easy`. */
typedef struct {
    double least, more;
    vec3 easy;
} principal_tensor;

/* Returns the sum of all components, which is not finite if one of them is not. RT */
static inline double plane_total(plane_tensor t) { return t.xx + t.xy + t.yy; }

/* Returns the mean over all directions. RT */
static inline double plane_mean(plane_tensor t) { return 0.5 * (t.xx + t.yy); }

/* Returns the components of a symmetric tensor across the track. RT */
plane_tensor plane_part(const mat3 *tensor, vec3 direction);

/* RT */
static inline plane_tensor plane_scaled(double s, plane_tensor t) { return (plane_tensor){s * t.xx, s * t.xy, s * t.yy}; }

/* Raises principal values that are below `least` to `least`. RT */
plane_tensor plane_at_least(plane_tensor t, double least);

/* RT */
principal_tensor plane_principal(plane_tensor t, vec3 direction);

#endif
