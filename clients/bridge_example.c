/* A bridge for a device of your own: fill in the two functions that talk to it. */
#include <sys/random.h>
#include <time.h>
#include <lcm/lcm.h>
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

static void read_device(double position[3], double orientation[4]) {      /* yours: m and w x y z, world frame */
    position[0] = 0.005, position[1] = 0.003, position[2] = -0.201;
    orientation[0] = 1, orientation[1] = orientation[2] = orientation[3] = 0;
}
static void render_on_device(const double force[3], const double torque[3]) { (void)force, (void)torque; } /* yours: N, N m */

enum { WATCHDOG = 20000 };                                                /* us without a wrench until the hand is let go */
typedef struct { trocar_needle_wrench_t wrench; int64_t arrival; } arrived;

static int64_t microseconds(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * INT64_C(1000000) + t.tv_nsec / 1000;
}

static void keep_newest(const lcm_recv_buf_t *buffer, const char *channel, const trocar_needle_wrench_t *wrench, void *newest) {
    (void)buffer, (void)channel;
    arrived *last = newest;
    if (last->wrench.server != 0 && last->wrench.server != wrench->server) return; /* two servers: follow the first */
    *last = (arrived){*wrench, microseconds(CLOCK_MONOTONIC)};
}

int main(void) {
    arrived newest = {0};
    trocar_needle_pose_t pose = {0};
    lcm_t *lcm = lcm_create(NULL);
    if (!lcm || getrandom(&pose.session, sizeof pose.session, 0) < 0) return 1; /* one's own; the first one owns the needle */
    trocar_needle_wrench_t_subscribe(lcm, "TROCAR_WRENCH", keep_newest, &newest);
    for (;; pose.seq++) {
        pose.utime = microseconds(CLOCK_REALTIME);
        read_device(pose.position, pose.orientation);
        trocar_needle_pose_t_publish(lcm, "TROCAR_POSE", &pose);          /* if the network refuses one, the next one follows */
        nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);          /* or block until the device's next frame */
        while (lcm_handle_timeout(lcm, 0) > 0) continue;                  /* drain: only the newest wrench counts */
        int alive = newest.wrench.session == pose.session && microseconds(CLOCK_MONOTONIC) - newest.arrival < WATCHDOG;
        if (!alive) newest = (arrived){0};                                /* server gone, or the needle is another's: no force */
        render_on_device(newest.wrench.force, newest.wrench.torque);
        pose.wrench_tick = newest.wrench.tick;                            /* lets the server measure the round trip */
    }
}
