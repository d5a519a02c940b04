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
    char lcm_url[256];       /* if empty, the URL is taken from the environment */
    const char *force_key;   /* if NULL, the key depends on the service's version */
    int needle;
    double rate;             /* Hz */
    double report;           /* s between two reports; 0 selects a single report at the end */
    bool realtime, start_given, length_given, direction_given, scale_given, force_scale_given;
    bool measure_delay;      /* measure the delay of the device instead of driving a needle */
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

/* Takes the needle's start, direction and length, and the scales of motion and force, from the scene unless options specify them. */
trocar_status haply_place(haply_settings *settings, trocar_error *why);

#endif
