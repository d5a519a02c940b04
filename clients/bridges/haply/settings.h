/* Options of trocar-haply. */
#ifndef TROCAR_HAPLY_SETTINGS_H
#define TROCAR_HAPLY_SETTINGS_H

#include "mapping.h"
#include "message.h"
#include "base/error.h"

typedef struct {
    char host[256];
    int port, events_port;   /* 0: none */
    haply_choice choice;
    char lcm_url[256];       /* empty: take the URL from the environment */
    const char *force_key;   /* NULL: depends on the service's version */
    int needle;
    double rate;             /* Hz */
    double report;           /* s, interval between reports; 0: only one report, at the end */
    bool realtime, start_given, length_given, direction_given, scale_given, force_scale_given;
    bool measure_delay;      /* measure the device's delay instead of driving a needle */
    bool patient;            /* start and offset are given in patient coordinates, mm */
    char scene[1024];        /* path of the scene; empty if none was given */
    mapping_settings mapping;
    double max_force;        /* N */
    double max_force_rate;   /* N/s */
    double force_scale;
    double tool_mass;        /* kg */
} haply_settings;

/* Parses the command line and the profile; exits if an option is invalid. */
void haply_parse(int count, char **arguments, haply_settings *settings);

/* Takes from the scene whatever the options leave open: the needle's start, direction and length, and the motion and force scales. */
trocar_status haply_place(haply_settings *settings, trocar_error *why);

#endif
