/* Patient coordinates as in DICOM, in millimetres: x points to the patient's left, y to the back, and z to the head. The key "patient_to_mesh" of a
   scene made from a scan maps them to the mesh. */
#ifndef TROCAR_PATIENT_H
#define TROCAR_PATIENT_H

#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"

typedef struct {
    vec3 origin;             /* m, position of the origin of patient coordinates in the mesh */
    quat turn;               /* rotation from the patient's axes to the axes of the mesh */
} patient_frame;

/* Reads the frame from the scene. BAD_INPUT if the scene has no key "patient_to_mesh". */
trocar_status patient_frame_read(const trocar_scene *scene, patient_frame *frame, trocar_error *why);

/* In these functions, a `frame` of NULL stands for mesh coordinates, which are returned unchanged. */
vec3 patient_to_mesh(const patient_frame *frame, vec3 point);      /* mm to m */
vec3 mesh_to_patient(const patient_frame *frame, vec3 point);      /* m to mm */
vec3 lengths_to_patient(const patient_frame *frame, vec3 vector);  /* converts a displacement from m to mm */
vec3 axes_to_patient(const patient_frame *frame, vec3 vector);     /* converts a force or a rotation, whose unit does not change */
quat turn_to_patient(const patient_frame *frame, quat orientation);
const char *patient_unit(const patient_frame *frame);              /* unit of positions: "mm", or "m" if `frame` is NULL */

/* Finds the pose of the needle's base before the insertion: the scene's "needle.start", with its position replaced by `given` (in the coordinates of
   `frame`) if that is not NULL. Components that neither of them defines keep their values in `start`. Returns true if the scene or `given` defines a
   position. */
bool find_start(const trocar_scene *scene, const patient_frame *frame, const vec3 *given, pose *start);

/* Finds the initial pose of the probe's base: the scene's "probe.start", in mesh coordinates. False if the scene has none. */
bool find_probe_start(const trocar_scene *scene, pose *start);

#endif
