/* Maps the device's cursor and handle to the pose of the needle's base in the scene, with a clutch. */
#ifndef TROCAR_HAPLY_MAPPING_H
#define TROCAR_HAPLY_MAPPING_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"

typedef struct {
    quat rotation;           /* rotation from the device frame to the scene frame */
    double scale;            /* metres of needle motion per metre of hand motion */
    vec3 start;              /* m, scene frame: where to put the needle's controlled point (tip or base) when the first cursor position arrives */
    vec3 offset;             /* m, scene frame: position of the device's origin; used instead of `start` if `has_offset` */
    bool has_offset;
    bool tip;                /* true: the cursor controls the needle's tip; false: its base */
    double length;           /* m, length of the needle; used only if `tip` is true */
    bool fixed;              /* true: the needle always lies along `direction` */
    vec3 direction;          /* direction of the needle in the scene without a handle */
    quat tool;               /* orientation of the needle in the handle frame */
} mapping_settings;

typedef struct {
    mapping_settings set;
    bool placed;
    vec3 origin;             /* m, scene frame: position of the device's origin */
    quat turn;               /* rotation of the needle relative to the handle; changes with each use of the clutch */
    quat orientation;        /* newest orientation of the needle in the scene */
    bool clutched;
    pose held;               /* pose of the base while the clutch is pressed */
} mapping;

void mapping_init(mapping *m, const mapping_settings *settings);

/* Returns the pose of the base for a cursor at `position` (m, device frame) and the handle's orientation. `handle` is NULL if there is no handle; the needle
   then keeps its orientation, and the clutch its state. While the clutch is pressed, the needle stays where it is. When it is released, the needle follows
   the hand from there. */
pose mapping_pose(mapping *m, vec3 position, const quat *handle, bool clutch);

/* Rotates a force from the scene frame to the device frame. */
vec3 mapping_force(const mapping *m, vec3 in_scene);

/* Default frames, for a device in front of a patient: the scene's z axis (into the body) is the device's +y axis (forward), and the scene's y axis (up) is
   the device's +z axis. The needle lies along the handle's +y axis, in which it points, and the bevel faces its +z axis. Both rotations are the half turn
   about (0, 1, 1), which swaps y and z. */
#define MAPPING_Y_TO_Z ((quat){0, 0, M_SQRT1_2, M_SQRT1_2})

#endif
