// A bridge for devices of the Force Dimension SDK (omega, delta, sigma, lambda). It has been compiled, but not run on hardware.
// Build: c++ bridge_forcedimension.cpp $(pkg-config --cflags --libs trocar-client) -ldhd -o bridge
// The scene should contain the limits of the device: device: {profile: omega.3}
// The first button is the clutch.
#include <cstdio>
#include <dhdc.h>
#include <trocar_client.h>
#include "frames.h"

static const frame scene = {FRAME_X_TOWARD_OPERATOR, {0.005, 0.003, -0.201}}; // the device's origin: tip 1 mm in front of the skin
static hand_map hand = {1, 1, {}, {}, 0};                 // scale and force_scale, as in the scene's section device

int main() {
    if (dhdOpen() < 0) return std::fprintf(stderr, "device: %s\n", dhdErrorGetLastStr()), 1;
    trocar_client *server = trocar_client_open(nullptr, nullptr, 0);
    if (!server) return dhdClose(), 1;
    dhdEnableForce(DHD_ON);
    for (;;) {
        double place[3], rotation[3][3], base[3], quaternion[4], force[3], torque[3];
        trocar_client_wrench wrench;
        if (dhdGetPosition(&place[0], &place[1], &place[2]) < 0 || dhdGetOrientationFrame(rotation) < 0) break;
        map_hand(&hand, dhdGetButton(0) == DHD_ON, place, place);
        pose_in_world(&scene, place, rotation, base, quaternion); // without a wrist, the rotation is the identity
        trocar_client_publish(server, base, quaternion);
        trocar_client_newest(server, &wrench);
        vector_on_device(&scene, wrench.force, force);
        vector_on_device(&scene, wrench.torque, torque);
        map_force(&hand, force);
        map_force(&hand, torque);
        if (dhdSetForceAndTorque(force[0], force[1], force[2], torque[0], torque[1], torque[2]) < 0) break;
    }
    std::fprintf(stderr, "device: %s\n", dhdErrorGetLastStr());
    trocar_client_close(server);
    dhdClose();
    return 1;
}
