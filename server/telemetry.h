/* The telemetry thread: publishes messages for monitors and viewers. It has its own LCM connection, so that a large message never
   holds the IO thread's transmit lock, and a separate thread for pictures, because the displacement of a large mesh may take long
   (minutes if a condensed inverse needs a factorisation for it). */
#ifndef TROCAR_TELEMETRY_H
#define TROCAR_TELEMETRY_H

#include <lcm/lcm.h>

#include "common/viewer_messages.h"
#include "exchange.h"
#include "intake/pose_arbiter.h"
#include "loop.h"
#include "worker.h"

typedef struct {
    const char *lcm_url;         /* NULL: its default */
    const char *scene_path;
    double rate_hz;
    int flags;                   /* NOT_REALTIME or 0, until the loop reports its flags */
    int64_t server;              /* number of this server */
    bool verbose;                /* a line per second on stderr */
} telemetry_settings;

typedef struct {
    exchange *exchange;
    telemetry_settings given;
    atomic_bool stop;
    lcm_t *lcm;
    char host[80];               /* this machine and process */
    const char *inverse;         /* description of the inverse */
    int needle_count;            /* of the scene */
    int64_t other_told;          /* the other server that was reported on stderr, 0: none; from here on used by the thread only */
    bool malformed_told;         /* a malformed pose has been reported on stderr */
    char other_text[400];
    char fault_told[sizeof(report)]; /* the last fault of the worker reported on stderr */
    char distant_text[200];      /* about packets of other machines, if there were any */
    int64_t timings_published;
    histogram *latency, *round_trip; /* of the worker and of the hand, in this interval */
    triple_buffer views;          /* view_sample, to the pictures' thread */
    viewer_messages messages;     /* used by the pictures' thread only, */
    struct { int64_t sent; int count; } seeds; /* ns, and the number of seeds in the last message, pending ones included; */
    struct { int64_t sent; int points; float end[3]; } tracks[TROCAR_MAX_NEEDLES]; /* ns of the last message of tracks, and the last point in it */
} telemetry;

/* Connects to LCM. `model` and `x` must outlive it. Network errors: see network_open. */
trocar_status telemetry_create(telemetry *t, const telemetry_settings *given, trocar_model *model, exchange *x, report *why);
void telemetry_free(telemetry *t);

/* Body of the thread; `context` is a telemetry. */
void *telemetry_run(void *context);
void telemetry_stop(telemetry *t);

#endif
