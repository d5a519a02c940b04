/* A pose. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_POSE_H
#define TROCAR_PUBLIC_POSE_H

typedef struct trocar_pose {
    double position[3];      /* m */
    double orientation[4];   /* unit quaternion, w x y z: rotates from the needle's frame to the world frame */
} trocar_pose;

#endif
