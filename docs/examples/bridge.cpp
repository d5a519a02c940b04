// The bridge in C++. Build: c++ bridge.cpp $(pkg-config --cflags --libs trocar-client) -o bridge
#include <memory>
#include <trocar_client.h>
#include "device.h" // yours

int main() {
    double position[3], orientation[4];
    trocar_client_wrench wrench;
    std::unique_ptr<trocar_client, void (*)(trocar_client *)> server(trocar_client_open(nullptr, nullptr, 0), trocar_client_close);
    if (!server) return 1;
    while (device_read(position, orientation)) {
        trocar_client_publish(server.get(), position, orientation);
        trocar_client_newest(server.get(), &wrench);
        device_render(wrench.force, wrench.torque);
    }
}
