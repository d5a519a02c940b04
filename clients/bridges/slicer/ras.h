/* RAS coordinates, as used by OpenIGTLink and 3D Slicer, in mm: x points to the patient's right, y to the front and z to the head. If the scene has no
   patient coordinates, the mesh axes are used as RAS axes, as in the viewer. */
#ifndef TROCAR_RAS_H
#define TROCAR_RAS_H

#include <stdbool.h>

#include "shared/patient.h"

/* Returns a frame with which the functions in patient.h (mesh_to_patient, patient_to_mesh, ...) convert to and from RAS instead of LPS. */
patient_frame ras_frame(const trocar_scene *scene);

/* A rigid transform in the order in which OpenIGTLink sends it: the columns of its rotation, then its translation. */
typedef struct {
    float numbers[12];
} ras_matrix;

ras_matrix ras_of_pose(const patient_frame *frame, pose p);              /* converts a pose in the mesh's frame, m */
ras_matrix ras_of_vector(const patient_frame *frame, const double v[3]); /* a pure translation by the vector, rotated from world axes to RAS;
                                                                            keeps the unit */

/* Returns NULL if a matrix is a valid pose, otherwise a message that says why not: a number is not finite, the axes are not orthonormal (tolerance 1e-3) or
   are left-handed, or the position is more than 10 m from the origin. */
const char *ras_fault(const ras_matrix *matrix);
pose ras_to_pose(const patient_frame *frame, const ras_matrix *matrix);  /* `matrix` must be a valid pose */

#endif
