/* Drives a needle for a browser: turns the browser's actions into orders to the publisher thread, and supervises the hand-over of needles. */
#ifndef TROCAR_PILOT_H
#define TROCAR_PILOT_H

#include <pthread.h>

#include "view/hand/pose_publisher.h"
#include "view/stream/subscriber.h"
#include "view/web/web.h"

/* Stages of a hand-over. Until the server has answered, a browser that leaves a needle, or takes one from rest, still holds it. */
typedef enum {
    HANDING_NOTHING,
    HANDING_LEFT,
    HANDING_TAKEN,
    HANDING_LAID,            /* the needle was in the tissue and nobody held it, so it is first left to rest and then taken */
    HANDING_DROPPED          /* the browser has released the needle in the tissue, so it is left to rest; nobody drives it */
} handover;

typedef struct {
    const trocar_model *model;
    const pose *parking_poses;       /* pose in which each needle waits outside the tissue */
    double needle_length;    /* m */
    subscriber *feed;
    web *web;
    pose_publisher publisher;
    pthread_t thread;
    bool running;            /* true while the publisher thread is running */
    int needle;              /* index of the needle that a browser drives, or drove last */
    bool driving;            /* true while a browser drives that needle */
    handover handing;        /* stage of a hand-over of that needle */
    int64_t handing_since;   /* ns, monotonic */
    int64_t replies_heeded;  /* value of subscriber.replies_heard up to which the replies have been handled */
    bool lies_down;          /* true if a needle that its browser releases in the tissue is left to rest; set in scenes with a template */
    bool has_hole;           /* true if the driven needle should move to a hole of the template */
    int guide, column, row;
    const char *lost;        /* reason why the browser lost the needle without asking for it; "" while a browser drives, or if it asked for the release */
    int64_t servers;         /* value of subscriber.servers for the server to which the driven needle belongs */
} pilot;

/* Starts the publisher thread. Uses `p`'s model, parking_poses, needle_length, feed and web, which must outlive the pilot. SYSTEM if LCM or the thread
   fails. */
trocar_status pilot_open(pilot *p, lcm_t *lcm, trocar_error *why);

/* Releases the needle. Must also be called if pilot_open has failed or was not called. */
void pilot_close(pilot *p);

/* Carries out an action of the driving browser. */
void pilot_act(pilot *p, const web_action *action);

/* Must be called after messages have been received. If the server has changed, the driving browser loses the needle, because the new server starts
   without an insertion. */
void pilot_hear(pilot *p);

/* Returns the reason why this needle cannot be driven, or NULL if it can. */
const char *pilot_trouble(const pilot *p, int needle);

/* Takes the needle away from the driving browser. `why`, a static string, is the reason. */
void pilot_let_go(pilot *p, const char *why);

/* True if pilot_trouble returns NULL: a server is running, and this needle does not belong to another client and does not rest, unless it is being handed
   over. */
bool pilot_has(const pilot *p, int needle);

/* True if a browser may take this needle. A browser that drives no needle may take a resting one. */
bool pilot_may_take(const pilot *p, int needle);

#endif
