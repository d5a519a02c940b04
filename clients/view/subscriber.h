/* What the server says on its channels, brought to a timeline. */
#ifndef TROCAR_SUBSCRIBER_H
#define TROCAR_SUBSCRIBER_H

#include <lcm/lcm.h>

#include "server_choice.h"
#include "timeline.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_status_t.h"

typedef struct {
    const mesh *mesh;
    timeline *timeline;
    int64_t started;         /* ns, monotonic: time 0 */
    double period;           /* s, of the server's loop */
    int64_t heard;           /* ns, monotonic: last wrench; 0: none */
    int64_t servers;         /* how many have been heard, one after the other */
    trocar_needle_wrench_t wrench;
    trocar_loop_timing_t timing;
    trocar_contacts_t *contacts; /* newest, NULL before the first */
    trocar_status_t *status; /* newest, NULL before the first */
    server_choice choice;    /* only the followed one's messages are taken */
    int64_t refused;         /* messages that are not what their channel says */
} subscriber;

/* Subscribes; `mesh` and `t` must outlive it. SYSTEM when LCM refuses. */
trocar_status subscriber_open(subscriber *f, lcm_t *lcm, const mesh *m, double rate_hz, timeline *t, report *why);
void subscriber_close(subscriber *f);

/* Whether a server has sent something in the last half second. */
bool subscriber_alive(const subscriber *f);

/* s since subscriber_open: the clock of the timeline. */
double subscriber_time(const subscriber *f);

/* Where the server has the needle's base: false if that is not known. */
bool subscriber_base(const subscriber *f, pose *base);

/* A tick's wrench as a point of the plots; timing stays zero. */
plot_sample sample_of_wrench(double time, const trocar_needle_wrench_t *w);

#endif
