/* A stand-in for a haptic device, for bridge.c and bridge.cpp: it rests 1 mm in front of the skin and moves at 1 kHz. Put the calls of your
   device's library here. */
#ifndef DEVICE_H
#define DEVICE_H

#include <time.h>

/* Waits for the device's next period, then returns the pose of the needle's base in the scene's world frame, or 0 to end. */
static inline int device_read(double position[3], double orientation[4]) {
    struct timespec period = {0, 1000000};
    nanosleep(&period, NULL);
    position[0] = 0.005, position[1] = 0.003, position[2] = -0.201; /* m */
    orientation[0] = 1, orientation[1] = orientation[2] = orientation[3] = 0; /* w x y z */
    return 1;
}

/* Applies a force in N and a torque in N m, both in the world frame, to the hand. */
static inline void device_render(const double force[3], const double torque[3]) {
    (void)force;
    (void)torque;
}

#endif
