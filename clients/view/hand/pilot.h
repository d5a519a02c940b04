/* Drives a needle for a browser: turns the browser's actions into orders to the publisher thread, and supervises hand-overs of needles. */
#ifndef TROCAR_PILOT_H
#define TROCAR_PILOT_H

#include <pthread.h>

#include "view/hand/pose_publisher.h"
#include "view/stream/subscriber.h"
#include "view/web/web.h"

/* What is being handed over. A browser that leaves a needle, or takes one from rest, still holds it until the server has answered. */
typedef enum {
    HANDING_NOTHING,
    HANDING_LEFT,
    HANDING_TAKEN,
    HANDING_LAID,            /* nobody held the needle in the tissue, so it is left to rest first and then taken */
    HANDING_DROPPED          /* the browser released the needle in the tissue, so it is left to rest; nobody drives it */
} handover;

typedef struct {
    const trocar_model *model;
    const pose *parking_poses;       /* where each needle waits outside the tissue */
    double needle_length;    /* m */
    subscriber *feed;
    web *web;
    pose_publisher publisher;
    pthread_t thread;
    bool running;            /* true while the publisher thread is running */
    int needle;              /* the needle that a browser drives, or drove last */
    bool driving;            /* true while a browser drives that needle */
    handover handing;        /* hand-over of that needle */
    int64_t handing_since;   /* ns, monotonic */
    int64_t replies_heeded;  /* subscriber.replies_heard when replies were last handled */
    bool lies_down;          /* true if a needle that is released in the tissue is left to rest, as in scenes with a template */
    bool has_hole;           /* true if the driven needle was sent to a hole of the template */
    int guide, column, row;
    const char *lost;        /* why the browser lost the needle; "" while a browser drives, or if it released the needle itself */
    int64_t servers;         /* subscriber.servers for the server that the driven needle belongs to */
} pilot;

/* Starts the publisher thread. Uses `p`'s model, parking_poses, needle_length, feed and web, which must outlive the pilot. Returns SYSTEM if LCM or the thread
   fails. */
trocar_status pilot_open(pilot *p, lcm_t *lcm, trocar_error *why);

/* Releases the needle. Call it even if pilot_open has failed or was never called. */
void pilot_close(pilot *p);

/* Carries out an action of the driving browser. */
void pilot_act(pilot *p, const web_action *action);

/* Asks the server to remove this needle and its seeds from the tissue. The server refuses if another client holds the needle. */
void pilot_clear(pilot *p, int needle);

/* Call it after messages have been received. If another server has taken over, the driving browser loses the needle, because that server starts without an
   insertion. */
void pilot_hear(pilot *p);

/* Returns why this needle cannot be driven, or NULL if it can. */
const char *pilot_trouble(const pilot *p, int needle);

/* Takes the needle away from the driving browser. `why` is the reason, a static string. */
void pilot_let_go(pilot *p, const char *why);

/* True if pilot_trouble returns NULL: a server is running, no other client owns this needle, and it is not resting (unless it is being handed over). */
bool pilot_has(const pilot *p, int needle);

/* True if a browser may take this needle. If it drives none, it may also take a resting one. */
bool pilot_may_take(const pilot *p, int needle);

#endif
