#include <stdio.h>
#include <trocar_client.h>
#include "device.h" /* yours: device_read and device_render */

int main(void) {
    double position[3], orientation[4];
    trocar_client_wrench wrench;
    char why[256];
    trocar_client *server = trocar_client_open(NULL, why, sizeof why);
    if (!server) return fprintf(stderr, "%s\n", why), 1;
    while (device_read(position, orientation)) {            /* m; w x y z */
        trocar_client_publish(server, position, orientation);
        trocar_client_newest(server, &wrench);              /* zero after 20 ms of silence */
        device_render(wrench.force, wrench.torque);         /* N; N m */
    }
    trocar_client_close(server);
}
