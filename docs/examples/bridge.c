#include <trocar_client.h>
#include "device.h" /* yours */

int main(void) {
    double position[3], orientation[4];
    trocar_client_wrench wrench;
    trocar_client *server = trocar_client_open(NULL, NULL, 0);
    if (!server) return 1;
    while (device_read(position, orientation)) {      /* position: m; orientation: w x y z */
        trocar_client_publish(server, position, orientation);
        trocar_client_newest(server, &wrench);        /* or zero: watchdog */
        device_render(wrench.force, wrench.torque);   /* N; N m */
    }
    trocar_client_close(server);
}
