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

vec3 patient_to_mesh(const patient_frame *frame, vec3 point);   /* mm to m */
vec3 mesh_to_patient(const patient_frame *frame, vec3 point);   /* m to mm */
vec3 axes_to_patient(const patient_frame *frame, vec3 vector);  /* a force or a displacement; its unit stays */
quat turn_to_patient(const patient_frame *frame, quat orientation);

/* The scene's "needle.start": where the needle's base waits before the insertion. Returns false, and leaves `start` as it is, if the
   scene has none. */
bool scene_start(const trocar_scene *scene, pose *start);

#endif
