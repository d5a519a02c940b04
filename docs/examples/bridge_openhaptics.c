/* A bridge for devices of OpenHaptics (Touch, Touch X, Premium). It has been compiled, but not run on hardware.
   cc bridge_openhaptics.c $(pkg-config --cflags --libs trocar-client) -lHD -o bridge
   The scene should contain the limits of the device: device: {profile: touch}
   The stylus' first button is the clutch. */
#include <stdio.h>
#include <HD/hd.h>
#include <trocar_client.h>
#include "frames.h"

static const frame scene = {FRAME_Z_TOWARD_OPERATOR, {0.005, 0.003, -0.201}}; /* the device's origin: tip 1 mm in front of the skin */
static hand_map hand = {.scale = 1, .force_scale = 1};    /* as in the scene's section device */

/* The scheduler calls this function a thousand times per second in its own thread. */
static HDCallbackCode HDCALLBACK exchange(void *user) {
    trocar_client *server = user;
    trocar_client_wrench wrench;
    double turn[16], place[3], rotation[3][3], base[3], quaternion[4], force[3];
    hdBeginFrame(hdGetCurrentDevice());
    HDint buttons = 0;
    hdGetDoublev(HD_CURRENT_TRANSFORM, turn); /* by columns; mm */
    hdGetIntegerv(HD_CURRENT_BUTTONS, &buttons);
    for (int i = 0; i < 3; i++) {
        place[i] = 1e-3 * turn[12 + i];
        for (int j = 0; j < 3; j++) rotation[i][j] = turn[4 * j + i];
    }
    map_hand(&hand, (buttons & HD_DEVICE_BUTTON_1) != 0, place, place);
    pose_in_world(&scene, place, rotation, base, quaternion);
    trocar_client_publish(server, base, quaternion);
    trocar_client_newest(server, &wrench);
    vector_on_device(&scene, wrench.force, force);
    map_force(&hand, force);
    hdSetDoublev(HD_CURRENT_FORCE, force); /* N; these devices render no torque */
    hdEndFrame(hdGetCurrentDevice());
    return HD_CALLBACK_CONTINUE;
}

int main(void) {
    HHD device = hdInitDevice(HD_DEFAULT_DEVICE);
    if (HD_DEVICE_ERROR(hdGetError())) return fprintf(stderr, "no device\n"), 1;
    trocar_client *server = trocar_client_open(NULL, NULL, 0);
    if (!server) return 1;
    hdEnable(HD_FORCE_OUTPUT);
    HDSchedulerHandle loop = hdScheduleAsynchronous(exchange, server, HD_DEFAULT_SCHEDULER_PRIORITY);
    hdStartScheduler();
    puts("Enter ends.");
    getchar();
    hdStopScheduler();
    hdUnschedule(loop);
    trocar_client_close(server);
    hdDisableDevice(device);
}
