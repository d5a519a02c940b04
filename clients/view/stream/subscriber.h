/* Receives the server's messages, keeps the newest of each kind, and adds them to a timeline. */
#ifndef TROCAR_SUBSCRIBER_H
#define TROCAR_SUBSCRIBER_H

#include <lcm/lcm.h>

#include "base/vec.h"
#include "shared/server_choice.h"
#include "trocar_command_reply_t.h"
#include "trocar_deformation_t.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_seeds_t.h"
#include "trocar_status_t.h"
#include "trocar_values_t.h"
#include "view/stream/timeline.h"

/* The newest messages about one needle. */
typedef struct {
    trocar_needle_wrench_t wrench;
    int64_t heard;           /* ns, monotonic: arrival of the last wrench; 0 before the first. The server sends none for a resting needle */
    trocar_contacts_t *contacts; /* NULL before the first message */
    trocar_tracks_t *tracks; /* NULL before the first message */
    trocar_status_t *status; /* NULL before the first message */
} needle_feed;

typedef struct {
    int node_count;          /* number of nodes of the scene's mesh */
    int needle_count;        /* number of needles of the scene */
    timeline *timeline;      /* NULL if no timeline is kept */
    int64_t started;         /* ns, monotonic: time of the timeline's zero */
    double period;           /* s, period of the server's loop */
    int64_t heard;           /* ns, monotonic: arrival of the last wrench; 0 before the first */
    int64_t silence, checked; /* ns; silence: time since the last wrench, counted only while this program was running; checked: time of the last count */
    int64_t tick, server;    /* tick and server of the last wrench */
    int64_t servers;         /* number of servers that have been followed so far */
    trocar_loop_timing_t timing;
    needle_feed needles[TROCAR_MAX_NEEDLES];
    trocar_probe probe;      /* newest state of the probe; not placed before the first message about it */
    int64_t probe_owner;     /* session that moves the probe; 0 before the first */
    trocar_seeds_t *seeds;   /* NULL before the first message */
    trocar_deformation_t *deformation; /* NULL before the first message */
    trocar_command_reply_t *reply; /* reply to the last command of `session` other than RELEASE; NULL before the first */
    trocar_command_reply_t *change_reply; /* reply to the last change that `session` asked for; NULL before the first */
    trocar_values_t *values; /* values that can be changed during the run; NULL before the first message */
    int64_t session;         /* the session that gives commands; set by the subscriber's owner */
    int64_t seeds_heard, replies_heard; /* number of messages so far, from all servers; a change of server counts as well */
    server_choice choice;    /* only messages of the followed server are used */
    int64_t refused;         /* number of messages of the wrong type for their channel */
} subscriber;

/* Subscribes; `t` must outlive it, and may be NULL. Ignores deformations of meshes with a number of nodes other than the model's, and needles that
   the model does not have. SYSTEM if LCM fails. */
trocar_status subscriber_open(subscriber *f, lcm_t *lcm, const trocar_model *model, timeline *t, trocar_error *why);
void subscriber_close(subscriber *f);

/* True if a wrench arrived within the last half second in which this program was running. At most 0.15 s since the previous call are counted,
   because messages that arrive while the program is not scheduled are handled later. */
bool subscriber_alive(subscriber *f);

/* Returns the time since subscriber_open, s: the clock of the timeline. */
double subscriber_time(const subscriber *f);

/* True if there is a needle or a probe to show. */
bool subscriber_shows(const subscriber *f);

/* Returns the session that owns the needle according to the newest messages; 0 if there is none. An owner that has been silent for two seconds, and may lose
   the needle to any other session, does not count. */
int64_t subscriber_owner(const subscriber *f, int needle);

/* Gets the pose of the needle's base in the server; false if it is unknown. */
bool subscriber_base(subscriber *f, int needle, pose *base);

/* Converts a wrench to a sample for the plots; timing values are zero. */
plot_sample sample_of_wrench(double time, const trocar_needle_wrench_t *w);

#endif
