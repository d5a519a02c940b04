/* Checks a device profile against a simulated device: does the needle's travel fit into the workspace, and is the loop stable and passive? */
#ifndef TROCAR_PROFILE_CHECK_H
#define TROCAR_PROFILE_CHECK_H

#include <stdbool.h>

#include "base/error.h"
#include "device/loop_margin.h"
#include "trocar.h"

/* What to check. A negative number means that it was not given. */
typedef struct {
    const char *profile;     /* device name, or path of a profile */
    const char *scene;       /* scene whose needle.start.depth is the needle's travel; NULL for the default depth */
    double mass, damping, stiffness; /* kg, N s/m, N/m: device and hand; if not given, the profile's mass, 2 N s/m, 500 N/m */
    double device_delay;     /* s, round trip between bridge and device; if not given, the profile's */
    double round_trip;       /* s, round trip between bridge and server */
    double rate;             /* Hz, rate of the device's loop */
} profile_settings;

typedef struct {
    char name[1024];
    trocar_device_limits limits; /* converted to the needle */
    double max_force, max_force_rate, max_stiffness; /* N, N/s, N/m, at the hand */
    double scale, force_scale;
    bool clutch;
    double width, height, depth; /* m, size of the workspace; NAN if unknown */
    double travel;           /* m, of the needle */
    int strokes;             /* hand strokes needed for this travel; 0 if the workspace is unknown */
    double device_delay;     /* s, round trip of the simulated device */
    double assumed_delay;    /* s, total delay for which the server would design the coupling */
    haptic_loop loop;
    double stability_margin, stability_frequency, simulated_margin, half_mass_margin; /* margins are factors by which the stiffness may grow; Hz */
    double required_damping, passivity_frequency, passivity_margin; /* N s/m; Hz; damping of device and hand divided by required_damping */
    loop_push_result push;
} profile_result;

trocar_status profile_check(const profile_settings *settings, profile_result *result, trocar_error *why);

/* Prints the result, with advice. Returns true if the travel fits and the loop is stable. */
bool profile_print(const profile_result *result, FILE *out);
void profile_write_json(const profile_result *result, FILE *out);

#endif
