/* Drives a needle for the browser that has it: turns its actions into orders to the publisher's thread, and watches needles that change hands. */
#ifndef TROCAR_PILOT_H
#define TROCAR_PILOT_H

#include <pthread.h>

#include "pose_publisher.h"
#include "subscriber.h"
#include "web.h"

/* A needle changes hands. Until the server has answered, the browser keeps a needle that it leaves or takes although it rests. */
typedef enum {
    HANDING_NOTHING,
    HANDING_LEFT,
    HANDING_TAKEN,
    HANDING_LAID,            /* it is to rest in order to be taken: nobody held it, and it was in the tissue */
    HANDING_DROPPED          /* it is to rest because its browser has let go of it in the tissue; nobody drives */
} handover;

typedef struct {
    const trocar_model *model;
    const pose *homes;       /* where each needle waits outside */
    double needle_length;    /* m */
    subscriber *feed;
    web *web;
    pose_publisher publisher;
    pthread_t thread;
    bool running;            /* the publisher's thread runs */
    int needle;              /* that a browser drives, or drove last */
    bool driving;            /* a browser drives it */
    handover handing;        /* whether that needle is being left or taken, */
    int64_t handing_since;   /* ns, monotonic */
    int64_t replies_heeded;  /* value of subscriber.replies_heard */
    bool lies_down;          /* a needle in the tissue rests once its browser has let go of it: the scene has a template */
    bool has_hole;           /* the driven needle is to go to a hole of the template: */
    int guide, column, row;
    const char *lost;        /* why its browser lost the needle without asking, "" while one drives and if it asked */
    int64_t servers;         /* value of subscriber.servers for the server that browsers drive */
} pilot;

/* `p` has model, homes, needle_length, feed and web, which must outlive it. SYSTEM if LCM or the thread fails. */
trocar_status pilot_open(pilot *p, lcm_t *lcm, report *why);

/* Releases the needle. Also if pilot_open has failed, or has not been called. */
void pilot_close(pilot *p);

/* What the driving browser wants. */
void pilot_act(pilot *p, const web_action *action);

/* After messages have been received. After a change of server the driving browser loses the needle, because the new server starts without an insertion. */
void pilot_hear(pilot *p);

/* Why this needle cannot be driven, NULL if it can. */
const char *pilot_trouble(const pilot *p, int needle);

/* The driving browser loses the needle for this reason, a string that stays. */
void pilot_let_go(pilot *p, const char *why);

/* Whether a server is running and this needle neither rests, unless it is being handed over, nor is owned by another client. */
bool pilot_has(const pilot *p, int needle);

/* Whether a browser may take this needle. One that drives none may take a needle that rests. */
bool pilot_may_take(const pilot *p, int needle);

#endif
