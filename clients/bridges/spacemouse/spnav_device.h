/* A 3Dconnexion device, through libspnav from spacenavd's socket ($SPNAV_SOCKET, `socket` in /etc/spnavrc, or /var/run/spnav.sock). Its axes are x to
   the right, y up, z away from the user, and rotations about these by the right-hand rule, for a device on the desk. */
#ifndef TROCAR_SPNAV_DEVICE_H
#define TROCAR_SPNAV_DEVICE_H

#include "input.h"

/* A process has one connection: libspnav keeps it in static variables. */
typedef struct {
    double full_scale;       /* counts of a full deflection; a SpaceMouse gives 350 at sensitivity 1 */
    bool reports_devices;    /* the daemon reports when a device comes and goes (protocol 1) */
    int64_t moved;           /* ns, monotonic: last event of a motion */
} spnav_device;

extern const input_driver spnav_driver;

#endif
