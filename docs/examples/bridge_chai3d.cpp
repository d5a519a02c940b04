// A bridge for every device that CHAI3D supports. It has been compiled, but not run on hardware.
// Build: c++ bridge_chai3d.cpp $(pkg-config --cflags --libs trocar-client) -I CHAI3D/src -lchai3d -o bridge
// The first user switch is the clutch.
#include <cstdio>
#include <chai3d.h>
#include <trocar_client.h>
#include "frames.h"

static const frame scene = {FRAME_X_TOWARD_OPERATOR, {0.005, 0.003, -0.201}}; // the device's origin: tip 1 mm in front of the skin
static hand_map hand = {1, 1, {}, {}, 0};                 // scale and force_scale, as in the scene's section device

int main() {
    chai3d::cHapticDeviceHandler handler;
    chai3d::cGenericHapticDevicePtr device;
    if (!handler.getDevice(device, 0) || !device->open() || !device->calibrate()) return std::fprintf(stderr, "no device\n"), 1;
    trocar_client *server = trocar_client_open(nullptr, nullptr, 0);
    if (!server) return 1;
    for (;;) {
        chai3d::cVector3d position;
        chai3d::cMatrix3d turn;
        bool pressed = false;
        if (!device->getPosition(position) || !device->getRotation(turn)) break;
        device->getUserSwitch(0, pressed);
        double place[3] = {position.x(), position.y(), position.z()}, rotation[3][3], base[3], quaternion[4], force[3], torque[3];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) rotation[i][j] = turn(i, j);
        map_hand(&hand, pressed, place, place);
        pose_in_world(&scene, place, rotation, base, quaternion);
        trocar_client_publish(server, base, quaternion);
        trocar_client_wrench wrench;
        trocar_client_newest(server, &wrench);
        vector_on_device(&scene, wrench.force, force);
        vector_on_device(&scene, wrench.torque, torque);
        map_force(&hand, force);
        map_force(&hand, torque);
        if (!device->setForceAndTorqueAndGripperForce(chai3d::cVector3d(force[0], force[1], force[2]),
                                                      chai3d::cVector3d(torque[0], torque[1], torque[2]), 0.0)) break;
    }
    std::fprintf(stderr, "the device does not answer\n");
    trocar_client_close(server);
    device->close();
    return 1;
}
