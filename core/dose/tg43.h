/* The TG-43 line-source formula. */
#ifndef TROCAR_TG43_H
#define TROCAR_TG43_H

#include "base/vec.h"
#include "dose/source.h"

enum { TG43_BLOCK = 256 };       /* number of points in a block */

typedef struct { vec3 centre, axis; } seed_place; /* m; the axis is a unit vector */

/* Computes the dose rates (Gy/h) at `count` <= TG43_BLOCK points (m) for a strength of 1 U, to within 1e-12 of the formula. A point inside the capsule gets the
   dose rate at the closest point of the capsule's side wall. RT */
void tg43_rates(const trocar_dose_source *s, const seed_place *seed, const double *x, const double *y, const double *z, int count, double *rate);

#endif
