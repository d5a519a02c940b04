/* Maps the device's cursor and handle to the pose of the needle's base in the scene, with a clutch. */
#ifndef TROCAR_HAPLY_MAPPING_H
#define TROCAR_HAPLY_MAPPING_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"

typedef struct {
    quat rotation;           /* rotates the device's frame to the scene's */
    double scale;            /* m of the needle per m of the hand */
    vec3 start;              /* m, scene's frame: position of the needle's point at the cursor when the first position arrives */
    vec3 offset;             /* m, scene's frame: position of the device's origin; replaces `start` if `has_offset` */
    bool has_offset;
    bool tip;                /* the needle's tip is at the cursor, not its base */
    double length;           /* m, length of the needle; only used if `tip` */
    bool fixed;              /* the needle always lies along `direction` */
    vec3 direction;          /* direction of the needle in the scene if there is no handle */
    quat tool;               /* orientation of the needle in the handle's frame */
} mapping_settings;

typedef struct {
    mapping_settings set;
    bool placed;
    vec3 origin;             /* m, scene's frame: position of the device's origin */
    quat turn;               /* rotation of the needle relative to the handle's direction, changed by each use of the clutch */
    quat orientation;        /* newest orientation of the needle */
    bool clutched;
    pose held;               /* pose of the base while the clutch is pressed */
} mapping;

void mapping_init(mapping *m, const mapping_settings *settings);

/* Returns the pose of the base for a cursor at `position` (m, device's frame) and the handle's orientation. If `handle` is NULL, there is no
   handle: the needle keeps its orientation and the clutch its state. While the clutch is pressed the needle stays; when the clutch is
   released, the needle continues from there. */
pose mapping_pose(mapping *m, vec3 position, const quat *handle, bool clutch);

/* Rotates a force from the scene's frame to the device's. */
vec3 mapping_force(const mapping *m, vec3 in_scene);

/* Default frames for a device in front of a patient. Scene: z (into the body) is the device's +y, forward, and y (up) is the device's +z. Needle
   in the handle: its axis lies along the handle's pointing direction +y, and its bevel faces the handle's +z. Both rotations are the half turn
   about (0, 1, 1), which exchanges y and z. */
#define MAPPING_Y_TO_Z ((quat){0, 0, M_SQRT1_2, M_SQRT1_2})

#endif
