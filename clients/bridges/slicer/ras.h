/* RAS coordinates, as in OpenIGTLink and 3D Slicer: millimetres along x to the patient's right, y to the front, z to the head. In a scene without
   patient coordinates the mesh's axes are used as RAS axes, as in the viewer. */
#ifndef TROCAR_RAS_H
#define TROCAR_RAS_H

#include <stdbool.h>

#include "shared/patient.h"

/* Returns a frame with which the functions of patient.h (mesh_to_patient, patient_to_mesh, ...) convert RAS instead of LPS coordinates. */
patient_frame ras_frame(const trocar_scene *scene);

/* A rigid transform in the order in which OpenIGTLink sends it: the columns of its rotation, then its translation. */
typedef struct {
    float numbers[12];
} ras_matrix;

ras_matrix ras_of_pose(const patient_frame *frame, pose p);              /* for a pose in the mesh's frame, m */
ras_matrix ras_of_vector(const patient_frame *frame, const double v[3]); /* a translation, rotated from world axes to RAS; the unit stays */

/* Returns the reason why a matrix is not a pose, or NULL: a number is not finite, the axes are not of length 1 and perpendicular
   (tolerance 1e-3) or are left-handed, or the position is more than 10 m away. */
const char *ras_fault(const ras_matrix *matrix);
pose ras_to_pose(const patient_frame *frame, const ras_matrix *matrix);  /* the matrix must be without fault */

#endif
