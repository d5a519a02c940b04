/* Maps the device's cursor and handle to the pose of the needle's base in the scene, with a clutch. */
#ifndef TROCAR_HAPLY_MAPPING_H
#define TROCAR_HAPLY_MAPPING_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"

typedef struct {
    quat rotation;           /* from the device's frame to the scene's */
    double scale;            /* m of the needle per m of the hand */
    vec3 start;              /* m, scene: of the needle's point at the cursor when the first position arrives */
    vec3 offset;             /* m, scene: of the device's origin; replaces `start` if */
    bool has_offset;
    bool tip;                /* the needle's tip is at the cursor, not its base */
    double length;           /* m, of the needle; matters for the tip only */
    bool fixed;              /* orientation: always along `direction` */
    vec3 direction;          /* of the needle in the scene, if there is no handle */
    quat tool;               /* of the needle in the handle's frame */
} mapping_settings;

typedef struct {
    mapping_settings set;
    bool placed;
    vec3 origin;             /* m, scene: of the device's origin */
    quat turn;               /* rotation of the needle relative to the handle's direction since the clutch was used */
    quat orientation;        /* the needle's newest */
    bool clutched;
    pose held;               /* of the base, while the clutch is pressed */
} mapping;

void mapping_init(mapping *m, const mapping_settings *settings);

/* Pose of the base for a cursor at `position` (m, device's frame) and the handle's orientation. NULL: there is no handle; the needle keeps its
   orientation and the clutch its state. While the clutch is pressed the needle stays; when released, it continues from there. */
pose mapping_pose(mapping *m, vec3 position, const quat *handle, bool clutch);

/* Force in the device's frame. */
vec3 mapping_force(const mapping *m, vec3 in_scene);

/* Default frames for a device in front of a patient: the scene's z (into the body) is the device's +y, forward; its y is up, the device's +z. The
   needle in the handle: its axis along the handle's +y, in which it points; its bevel towards the handle's +z. Both are the half turn about (0, 1,
   1), which exchanges y and z. */
#define MAPPING_Y_TO_Z ((quat){0, 0, M_SQRT1_2, M_SQRT1_2})

#endif
