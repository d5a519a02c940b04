/* RAS coordinates, as used by OpenIGTLink and 3D Slicer, in millimetres: x points to the patient's right, y to the front, and z to the head. In a
   scene without patient coordinates the mesh's axes are used as RAS axes, as in the viewer. */
#ifndef TROCAR_RAS_H
#define TROCAR_RAS_H

#include <stdbool.h>

#include "shared/patient.h"

/* Returns a frame that makes the functions of patient.h (mesh_to_patient, patient_to_mesh, ...) convert to and from RAS instead of LPS
   coordinates. */
patient_frame ras_frame(const trocar_scene *scene);

/* A rigid transform in the order in which OpenIGTLink sends it: the columns of its rotation, then its translation. */
typedef struct {
    float numbers[12];
} ras_matrix;

ras_matrix ras_of_pose(const patient_frame *frame, pose p);              /* converts a pose in the mesh's frame, m */
ras_matrix ras_of_vector(const patient_frame *frame, const double v[3]); /* makes a pure translation from a vector, rotated from world axes to RAS;
                                                                            the unit is unchanged */

/* Returns the reason why a matrix is not a valid pose, or NULL if it is valid. Reasons: a number is not finite, the axes are not unit vectors
   perpendicular to each other (tolerance 1e-3), the axes are left-handed, or the position is more than 10 m from the origin. */
const char *ras_fault(const ras_matrix *matrix);
pose ras_to_pose(const patient_frame *frame, const ras_matrix *matrix);  /* `matrix` must be a valid pose */

#endif
