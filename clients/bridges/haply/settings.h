/* Options of trocar-haply. */
#ifndef TROCAR_HAPLY_SETTINGS_H
#define TROCAR_HAPLY_SETTINGS_H

#include "mapping.h"
#include "message.h"
#include "base/report.h"

typedef struct {
    char host[256];
    int port, events_port;   /* 0: none */
    haply_choice choice;
    char lcm_url[256];       /* empty: the environment's */
    const char *force_key;   /* NULL: depends on the service's version */
    int needle;
    double rate;             /* Hz */
    double report;           /* s; 0: at the end only */
    bool realtime, start_given, length_given, direction_given;
    bool measure_delay;      /* instead of holding a needle */
    bool patient;            /* start and offset are in the patient's coordinates, mm */
    char scene[1024];        /* path; empty: none */
    mapping_settings mapping;
    double max_force;        /* N */
    double max_force_rate;   /* N/s */
    double force_scale;
    double tool_mass;        /* kg */
} haply_settings;

/* Exits if an option is wrong. */
void haply_parse(int count, char **arguments, haply_settings *settings);

/* Takes missing options from the scene: the needle's start, direction and length. */
trocar_status haply_place(haply_settings *settings, report *why);

#endif
