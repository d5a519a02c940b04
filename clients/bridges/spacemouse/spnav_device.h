/* A 3Dconnexion device, through libspnav and spacenavd's socket ($SPNAV_SOCKET, `socket` in /etc/spnavrc, or /var/run/spnav.sock). If the device
   stands on the desk, its axes are x to the right, y up and z away from the user; rotations about these axes follow the right-hand rule. */
#ifndef TROCAR_SPNAV_DEVICE_H
#define TROCAR_SPNAV_DEVICE_H

#include "input.h"

/* A process can have only one connection, because libspnav keeps it in static variables. */
typedef struct {
    double full_scale;       /* counts at full deflection; a SpaceMouse sends 350 at sensitivity 1 */
    bool reports_devices;    /* the daemon reports when a device is connected or removed (protocol 1) */
    int64_t moved;           /* ns, monotonic: time of the last motion event */
} spnav_device;

extern const input_driver spnav_driver;

#endif
