/* Conversions between a device's frame and the scene's world frame, for the bridges in this folder.

   In the scenes of trocar, the view is along the needle: z goes from the skin into the body, y is up, and x points to the viewer's left. */
#ifndef FRAMES_H
#define FRAMES_H

#include <math.h>

typedef struct frame {
    double turn[3][3];  /* row i: world axis i in device coordinates */
    double origin[3];   /* m, in the world frame: position of the needle's base when the device is at its own origin */
} frame;

/* For devices whose x axis points to the operator's right, y up and z toward the operator (OpenHaptics). */
#define FRAME_Z_TOWARD_OPERATOR {{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}}
/* For devices whose x axis points toward the operator, y to the right and z up (Force Dimension, CHAI3D). */
#define FRAME_X_TOWARD_OPERATOR {{0, -1, 0}, {0, 0, 1}, {-1, 0, 0}}

/* Computes the unit quaternion w, x, y, z of a rotation matrix. It divides by the largest of the four components, and so never by zero. */
static inline void quaternion_of_matrix(double m[3][3], double q[4]) {
    double s[4] = {1 + m[0][0] + m[1][1] + m[2][2], 1 + m[0][0] - m[1][1] - m[2][2],
                   1 - m[0][0] + m[1][1] - m[2][2], 1 - m[0][0] - m[1][1] + m[2][2]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (s[i] > s[k]) k = i;
    double r = sqrt(s[k]), f = 0.5 / r;
    double a = m[2][1] - m[1][2], b = m[0][2] - m[2][0], c = m[1][0] - m[0][1];
    double d = m[1][0] + m[0][1], e = m[0][2] + m[2][0], g = m[2][1] + m[1][2];
    double all[4][4] = {{0, a, b, c}, {a, 0, d, e}, {b, d, 0, g}, {c, e, g, 0}};
    for (int i = 0; i < 4; i++) q[i] = f * all[k][i];
    q[k] = 0.5 * r;
}

/* Computes the pose of the needle's base, whose axis is the device's forward axis, which points away from the operator when the stylus is level. `position` (m)
   and `rotation` are in the device's frame. */
static inline void pose_in_world(const frame *f, double position[3], double rotation[3][3], double base[3], double quaternion[4]) {
    double half[3][3], world[3][3];
    for (int i = 0; i < 3; i++) {
        base[i] = f->origin[i];
        for (int j = 0; j < 3; j++) {
            base[i] += f->turn[i][j] * position[j];
            half[i][j] = f->turn[i][0] * rotation[0][j] + f->turn[i][1] * rotation[1][j] + f->turn[i][2] * rotation[2][j];
        }
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            world[i][j] = half[i][0] * f->turn[j][0] + half[i][1] * f->turn[j][1] + half[i][2] * f->turn[j][2];
    quaternion_of_matrix(world, quaternion);
}

/* Converts a force or a torque from the world frame to the device's frame. */
static inline void vector_on_device(const frame *f, const double world[3], double device[3]) {
    for (int j = 0; j < 3; j++) device[j] = f->turn[0][j] * world[0] + f->turn[1][j] * world[1] + f->turn[2][j] * world[2];
}

/* How the needle follows the hand: device.scale and device.force_scale of the scene, and a clutch. Set the first two; the rest starts at 0. */
typedef struct hand_map {
    double scale;        /* motion of the needle per motion of the hand */
    double force_scale;  /* force on the hand per force on the needle */
    double offset[3];    /* m, in the device's frame: position of the needle when the hand is at the device's origin */
    double needle[3];    /* m, in the device's frame: last position of the needle */
    double strength;     /* fraction of the force that is rendered */
} hand_map;

/* Computes the needle's position from the hand's, both in the device's frame. While the clutch is pressed, the needle stays where it is, and the hand feels no
   force; then the needle goes on from there, and the force returns within 100 periods. The orientation follows the hand all the time. */
static inline void map_hand(hand_map *m, int clutch, const double hand[3], double needle[3]) {
    for (int i = 0; i < 3; i++) {
        if (clutch) m->offset[i] = m->needle[i] - m->scale * hand[i];
        m->needle[i] = needle[i] = m->offset[i] + m->scale * hand[i];
    }
    m->strength = clutch ? 0 : fmin(1, m->strength + 0.01);
}

/* Converts a force or a torque on the needle to that on the hand. */
static inline void map_force(const hand_map *m, double force[3]) {
    for (int i = 0; i < 3; i++) force[i] *= m->force_scale * m->strength;
}

#endif
