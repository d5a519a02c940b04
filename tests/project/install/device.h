/* A device for the documentation's bridge example: pushes the needle in by 21 mm and logs time and force. See tests/project/test_install.sh. */
#include <math.h>
#include <stdio.h>
#include <time.h>

static int device_read(double position[3], double orientation[4]) {
    static int steps;
    nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
    if (steps < 210) steps++;
    position[0] = 0.005, position[1] = 0.003, position[2] = -0.201 + 0.1e-3 * steps;
    orientation[0] = 1, orientation[1] = orientation[2] = orientation[3] = 0;
    return 1;
}

static void device_render(const double force[3], const double torque[3]) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    fprintf(stderr, "%.6f %g\n", (double)now.tv_sec + 1e-9 * (double)now.tv_nsec, hypot(hypot(force[0], force[1]), force[2]) + fabs(torque[0]));
}
