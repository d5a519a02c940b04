/* RAS coordinates, as in OpenIGTLink and 3D Slicer: millimetres along x to the patient's right, y to the front, z to the head. In a scene without
   patient coordinates the mesh's axes count as these, as in the viewer. */
#ifndef TROCAR_RAS_H
#define TROCAR_RAS_H

#include <stdbool.h>

#include "shared/patient.h"

/* Makes the frame's functions (patient.h) give and take RAS instead of LPS: mesh_to_patient, patient_to_mesh, ... */
patient_frame ras_frame(const trocar_scene *scene);

/* A rigid transform in the order in which OpenIGTLink sends it: the columns of its rotation, then its translation. */
typedef struct {
    float numbers[12];
} ras_matrix;

ras_matrix ras_of_pose(const patient_frame *frame, pose p);              /* in the mesh, m */
ras_matrix ras_of_vector(const patient_frame *frame, const double v[3]); /* a translation: world axes to RAS, the unit stays */

/* The reason why a matrix is not a pose, or NULL: a number that is not finite, axes that are not of length 1 and perpendicular (1e-3), or
   left-handed, or a position more than 10 m away. */
const char *ras_fault(const ras_matrix *matrix);
pose ras_to_pose(const patient_frame *frame, const ras_matrix *matrix);  /* of one without a fault */

#endif
