/* The telemetry thread publishes messages for monitors and viewers. It uses its own LCM connection, so that a large message never holds the IO thread's
   transmit lock. A second thread publishes the pictures, because computing the displacement of a large mesh may take long: minutes if a condensed inverse must
   first be factorised. */
#ifndef TROCAR_TELEMETRY_H
#define TROCAR_TELEMETRY_H

#include <lcm/lcm.h>

#include "common/viewer_messages.h"
#include "exchange.h"
#include "intake/pose_arbiter.h"
#include "loop.h"
#include "worker.h"

typedef struct {
    const char *lcm_url;         /* LCM URL; NULL for LCM's default */
    const char *scene_path;
    double rate_hz;
    int flags;                   /* NOT_REALTIME or 0, used until the loop reports its own flags */
    int64_t server;              /* this server's ID */
    bool verbose;                /* print one line per second on stderr */
} telemetry_options;

typedef struct {
    exchange *exchange;
    telemetry_options given;
    atomic_bool stop;
    lcm_t *lcm;
    char host[80];               /* this machine's name, followed by the process ID */
    const char *inverse;         /* text that describes the inverse */
    int needle_count;            /* number of needles in the scene */
    int64_t other_told;          /* ID of the other server reported on stderr; 0 if none. From here on, used only by the thread */
    bool malformed_told;         /* a malformed pose has been reported on stderr */
    char other_text[400];
    char fault_told[sizeof(trocar_error)]; /* the worker's fault last reported on stderr */
    char distant_text[200];      /* message about packets from other machines; empty if there were none */
    int64_t timings_published;
    histogram *latency, *round_trip; /* of the worker's answers and of the hand, both in the current interval */
    triple_buffer views;          /* of view_sample; read by the pictures thread */
    viewer_messages messages;     /* used only by the pictures thread */
    struct { int64_t sent; int count; } seeds; /* ns, when the last message was sent; how many seeds it contained, including pending ones */
    struct { int64_t sent; int points; float end[3]; } tracks[TROCAR_MAX_NEEDLES]; /* ns, when the last message was sent; how many points the tracks had, and
                                                                                      the last of them */
} telemetry;

/* Connects to LCM. `model` and `x` must outlive the telemetry. Errors as in network_open. */
trocar_status telemetry_create(telemetry *t, const telemetry_options *given, trocar_model *model, exchange *x, trocar_error *why);
void telemetry_free(telemetry *t);

/* Main function of the thread. `context` is a telemetry. */
void *telemetry_run(void *context);
void telemetry_stop(telemetry *t);

#endif
