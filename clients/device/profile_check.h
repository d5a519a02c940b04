/* Checks a device profile with a simulated device: whether the needle's travel fits into the workspace, and whether the loop is stable and passive. */
#ifndef TROCAR_PROFILE_CHECK_H
#define TROCAR_PROFILE_CHECK_H

#include <stdbool.h>

#include "base/error.h"
#include "device/loop_margin.h"
#include "trocar.h"

/* What to check. Numbers that are not given are negative. */
typedef struct {
    const char *profile;     /* name of a device, or path of a profile */
    const char *scene;       /* path of the scene whose needle.start.depth is the needle's travel; NULL: the default depth */
    double mass, damping, stiffness; /* kg, N s/m, N/m: device and hand; not given: the profile's mass, 2 N s/m, 500 N/m */
    double device_delay;     /* s, round trip between bridge and device; not given: the profile's */
    double round_trip;       /* s, round trip between bridge and server */
    double rate;             /* Hz, rate of the device's loop */
} profile_settings;

typedef struct {
    char name[1024];
    trocar_device_limits limits; /* the limits, converted to the needle */
    double max_force, max_force_rate, max_stiffness; /* N, N/s, N/m: at the hand */
    double scale, force_scale;
    bool clutch;
    double width, height, depth; /* m, workspace; NAN if unknown */
    double travel;           /* m, travel of the needle */
    int strokes;             /* number of hand strokes needed for this travel; 0 if the workspace is unknown */
    double device_delay;     /* s, round-trip delay of the simulated device */
    double assumed_delay;    /* s, total delay for which the server designs the coupling */
    haptic_loop loop;
    double stability_margin, stability_frequency, simulated_margin, half_mass_margin; /* margins: factors of the stiffness; stability_frequency: Hz */
    double required_damping, passivity_frequency, passivity_margin; /* N s/m; Hz; damping divided by required_damping */
    loop_push_result push;
} profile_result;

trocar_status profile_check(const profile_settings *settings, profile_result *result, trocar_error *why);

/* Prints the result with advice. Returns true if the travel fits and the loop is stable. */
bool profile_print(const profile_result *result, FILE *out);
void profile_write_json(const profile_result *result, FILE *out);

#endif
