/* Evaluates a snapshot at a point of the tissue. The point is given by the `handles` of its element's corners and their `weights`. */
#ifndef TROCAR_SNAPSHOT_KERNELS_H
#define TROCAR_SNAPSHOT_KERNELS_H

#include "snapshot/snapshot.h"

typedef struct {
    int handle;
    vec3 force;              /* N */
} handle_load;

/* Returns the compliance (m/N) between the point and a handle. RT */
mat3 compliance_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other);

/* Returns the compliance (m/N) of the point under a force that is distributed to the corners with different weights. RT */
mat3 compliance_of_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], const double force_weights[4]);

/* Returns the displacement (m) of the point under loads at handles. RT */
vec3 displacement_under(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int count, const handle_load *loads);

#endif
