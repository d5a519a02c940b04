/* Patient coordinates as in DICOM, in millimetres: x points to the patient's left, y to the back and z to the head. In a scene made from a scan, the key
   "patient_to_mesh" maps them to the mesh. */
#ifndef TROCAR_PATIENT_H
#define TROCAR_PATIENT_H

#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"

typedef struct {
    vec3 origin;             /* m, where the origin of patient coordinates is in the mesh */
    quat turn;               /* rotates the patient's axes to the mesh's */
} patient_frame;

/* Reads the frame from the scene. Returns BAD_INPUT if the scene has no "patient_to_mesh". */
trocar_status patient_frame_read(const trocar_scene *scene, patient_frame *frame, trocar_error *why);

/* If `frame` is NULL, these functions return mesh coordinates unchanged. */
vec3 patient_to_mesh(const patient_frame *frame, vec3 point);      /* mm to m */
vec3 mesh_to_patient(const patient_frame *frame, vec3 point);      /* m to mm */
vec3 lengths_to_patient(const patient_frame *frame, vec3 vector);  /* converts a displacement from m to mm */
vec3 axes_to_patient(const patient_frame *frame, vec3 vector);     /* rotates a force, or a rotation vector; the unit stays the same */
quat turn_to_patient(const patient_frame *frame, quat orientation);
const char *patient_unit(const patient_frame *frame);              /* of positions: "mm", or "m" if `frame` is NULL */

/* Finds the pose of the needle's base before the insertion: the scene's "needle.start". If `given` is not NULL, it replaces the position (in the coordinates of
   `frame`). Components that neither defines keep their values in `start`. Returns true if the scene or `given` defines a position. */
bool find_start(const trocar_scene *scene, const patient_frame *frame, const vec3 *given, pose *start);

/* Finds the initial pose of the probe's base, the scene's "probe.start", in mesh coordinates. Returns false if the scene has none. */
bool find_probe_start(const trocar_scene *scene, pose *start);

#endif
