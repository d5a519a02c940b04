// The bridge in C++. c++ bridge.cpp $(pkg-config --cflags --libs trocar-client) -o bridge
#include <cstdio>
#include <memory>
#include <trocar_client.h>
#include "device.h" // yours: device_read and device_render

int main() {
    double position[3], orientation[4];
    trocar_client_wrench wrench;
    char why[256];
    std::unique_ptr<trocar_client, void (*)(trocar_client *)> server(trocar_client_open(nullptr, why, sizeof why), trocar_client_close);
    if (!server) return std::fprintf(stderr, "%s\n", why), 1;
    while (device_read(position, orientation)) {
        trocar_client_publish(server.get(), position, orientation);
        trocar_client_newest(server.get(), &wrench);
        device_render(wrench.force, wrench.torque);
    }
}
