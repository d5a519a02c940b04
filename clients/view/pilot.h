/* Drives a needle for the browser that has it: turns its actions into orders to the publisher's thread, and watches needles that change hands. */
#ifndef TROCAR_PILOT_H
#define TROCAR_PILOT_H

#include <pthread.h>

#include "pose_publisher.h"
#include "subscriber.h"
#include "web.h"

/* A resting needle changes hands: until the server has answered, the browser keeps it although it rests. */
typedef enum { HANDING_NOTHING, HANDING_LEFT, HANDING_TAKEN } handover;

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

/* Whether a server is running and this needle neither rests, unless it is being handed over, nor is owned by another client. */
bool pilot_has(const pilot *p, int needle);

/* Whether a browser may take this needle. One that drives none may take a needle that rests. */
bool pilot_may_take(const pilot *p, int needle);

#endif
