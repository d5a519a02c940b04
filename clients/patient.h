/* Patient coordinates, as DICOM defines them: millimetres along x to the patient's left, y to the back, z to the head. A scene made
   from a scan says how they map to its mesh (key "patient_to_mesh"). */
#ifndef TROCAR_PATIENT_H
#define TROCAR_PATIENT_H

#include <stdbool.h>

#include "base/report.h"
#include "base/vec.h"
#include "trocar.h"

typedef struct {
    vec3 origin;             /* m: the patient's origin in the mesh */
    quat turn;               /* turns the patient's axes into the mesh's */
} patient_frame;

/* BAD_INPUT if the scene does not say. */
trocar_status patient_frame_read(const trocar_scene *scene, patient_frame *frame, report *why);

/* `frame` NULL: the mesh's coordinates are meant, and nothing changes. */
vec3 patient_to_mesh(const patient_frame *frame, vec3 point);      /* mm to m */
vec3 mesh_to_patient(const patient_frame *frame, vec3 point);      /* m to mm */
vec3 lengths_to_patient(const patient_frame *frame, vec3 vector);  /* a displacement, m to mm */
vec3 axes_to_patient(const patient_frame *frame, vec3 vector);     /* a force or a rotation; its unit stays */
quat turn_to_patient(const patient_frame *frame, quat orientation);
const char *patient_unit(const patient_frame *frame);              /* of positions */

/* Where the needle's base waits before the insertion: the scene's "needle.start", moved to `given`, a position in the coordinates of
   `frame`, if that is not NULL. What neither says stays as it is in `start`. Returns whether there is a position. */
bool find_start(const trocar_scene *scene, const patient_frame *frame, const vec3 *given, pose *start);

/* Where the probe's base is until it is moved: the scene's "probe.start", in the mesh's coordinates. False: the scene does not say. */
bool find_probe_start(const trocar_scene *scene, pose *start);

#endif
