/* A bridge for a device of your own: fill in the two functions that talk to it. */
#include <poll.h>
#include <time.h>
#include <lcm/lcm.h>
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

static void read_device(double position[3], double orientation[4]) {      /* yours: m and w x y z, world frame */
    position[0] = 0.005, position[1] = 0.003, position[2] = -0.201;
    orientation[0] = 1, orientation[1] = orientation[2] = orientation[3] = 0;
}
static void render_on_device(const double force[3], const double torque[3]) { (void)force, (void)torque; } /* yours: N, N m */

static void keep_newest(const lcm_recv_buf_t *buffer, const char *channel, const trocar_needle_wrench_t *wrench, void *newest) {
    (void)buffer, (void)channel;
    *(trocar_needle_wrench_t *)newest = *wrench;
}

int main(void) {
    trocar_needle_wrench_t wrench = {0};
    trocar_needle_pose_t pose = {.session = time(NULL)};                  /* a number of one's own; the first one owns the needle */
    lcm_t *lcm = lcm_create(NULL);
    if (!lcm) return 1;
    trocar_needle_wrench_t_subscribe(lcm, "TROCAR_WRENCH", keep_newest, &wrench);
    for (;; pose.seq++) {
        struct timespec now, period = {0, 1000000};                       /* or block until the device's next frame */
        clock_gettime(CLOCK_REALTIME, &now);
        pose.utime = now.tv_sec * INT64_C(1000000) + now.tv_nsec / 1000;
        read_device(pose.position, pose.orientation);
        if (trocar_needle_pose_t_publish(lcm, "TROCAR_POSE", &pose) != 0) return 1;
        nanosleep(&period, NULL);
        while (lcm_handle_timeout(lcm, 0) > 0) continue;                  /* drain: only the newest wrench counts */
        if (wrench.session != pose.session) continue;
        render_on_device(wrench.force, wrench.torque);
        pose.wrench_tick = wrench.tick;                                   /* lets the server measure the round trip */
    }
}
