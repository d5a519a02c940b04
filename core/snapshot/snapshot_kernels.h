/* Evaluates the snapshot at a point of the tissue, given the `handles` and `weights` of the corners of its element. */
#ifndef TROCAR_SNAPSHOT_KERNELS_H
#define TROCAR_SNAPSHOT_KERNELS_H

#include "snapshot/snapshot.h"

typedef struct {
    int handle;
    vec3 force;              /* N */
} handle_load;

/* Compliance (m/N) between the point and a handle. RT */
mat3 compliance_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other);

/* Compliance (m/N) of the point under a force that is distributed to the corners with other weights. RT */
mat3 compliance_of_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], const double force_weights[4]);

/* Displacement (m) of the point under loads at handles. RT */
vec3 displacement_under(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int count, const handle_load *loads);

#endif
