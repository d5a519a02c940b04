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
    int64_t heard;           /* ns, monotonic, when the last wrench arrived; 0 before the first. A resting needle gets none */
    trocar_contacts_t *contacts; /* NULL before the first message */
    trocar_tracks_t *tracks; /* NULL before the first message */
    trocar_status_t *status; /* NULL before the first message */
} needle_feed;

typedef struct {
    int node_count;          /* of the scene's mesh */
    int needle_count;        /* needles in the scene */
    timeline *timeline;      /* NULL if no timeline is kept */
    int64_t started;         /* ns, monotonic, when the timeline starts */
    double period;           /* s, of the server's loop */
    int64_t heard;           /* ns, monotonic, when the last wrench arrived; 0 before the first */
    int64_t silence, checked; /* ns since the last wrench, counting only time in which this program was running; and when that was last counted */
    int64_t tick, server;    /* of the last wrench */
    int64_t servers;         /* how many servers have been followed so far */
    trocar_loop_timing_t timing;
    needle_feed needles[TROCAR_MAX_NEEDLES];
    trocar_probe probe;      /* newest state of the probe; not placed before the first message about it */
    int64_t probe_owner;     /* session that moves the probe; 0 before the first message */
    trocar_seeds_t *seeds;   /* NULL before the first message */
    trocar_deformation_t *deformation; /* NULL before the first message */
    trocar_command_reply_t *reply; /* to the last command of `session` other than RELEASE; NULL before the first */
    trocar_command_reply_t *change_reply; /* to the last change that `session` asked for; NULL before the first */
    trocar_values_t *values; /* values that can be changed while the server runs; NULL before the first message */
    int64_t session;         /* session whose replies to keep; set by the owner of the subscriber */
    int64_t seeds_heard, replies_heard; /* how many messages so far, from all servers; switching to another server also counts */
    server_choice choice;    /* chooses the server whose messages are used */
    int64_t refused;         /* messages of the wrong type for their channel */
} subscriber;

/* Subscribes. `t` may be NULL; otherwise it must outlive the subscriber. Ignores deformations whose number of nodes is not the model's, and needles that the
   model lacks. Returns SYSTEM if LCM fails. */
trocar_status subscriber_open(subscriber *f, lcm_t *lcm, const trocar_model *model, timeline *t, trocar_error *why);
void subscriber_close(subscriber *f);

/* True if a wrench has arrived within the last half second. Time in which this program was not running does not count, because it handles messages from then
   only later: at most 0.15 s are counted since the previous call. */
bool subscriber_alive(subscriber *f);

/* Returns the time since subscriber_open (s), which is the timeline's clock. */
double subscriber_time(const subscriber *f);

/* True if there is a needle or a probe to show. */
bool subscriber_shows(const subscriber *f);

/* Returns the session that owns the needle according to the newest messages, or 0 if there is none. An owner that has been silent for two seconds does not
   count, because any other session could take the needle from it. */
int64_t subscriber_owner(const subscriber *f, int needle);

/* Gets the pose of the needle's base in the server. Returns false if it is unknown. */
bool subscriber_base(subscriber *f, int needle, pose *base);

/* Converts a wrench to a sample for the plots, with zero for the timing values. */
plot_sample sample_of_wrench(double time, const trocar_needle_wrench_t *w);

#endif
