/* A 3Dconnexion device, read with libspnav through spacenavd's socket ($SPNAV_SOCKET, `socket` in /etc/spnavrc, or /var/run/spnav.sock). With the device on
   the desk, x points right, y up and z away from the user; rotations about these axes follow the right-hand rule. */
#ifndef TROCAR_SPNAV_DEVICE_H
#define TROCAR_SPNAV_DEVICE_H

#include "input.h"

/* Only one connection per process is possible, because libspnav keeps it in static variables. */
typedef struct {
    double full_scale;       /* counts at full deflection; a SpaceMouse sends 350 at sensitivity 1 */
    bool reports_devices;    /* the daemon reports when devices are connected or removed (protocol 1) */
    int64_t moved;           /* ns, monotonic: time of the last motion event */
} spnav_device;

extern const input_driver spnav_driver;

#endif
