/* Moves a needle of the server by the poses of a tracker, and the probe by those of a tracker or stepper. A tracker sends 20 to 100 poses a second,
   while the server needs one every few milliseconds: a thread interpolates between the tracker's poses, one tracker period behind. The client holds
   the needle from the first pose on, keeps it still while poses are missing, and releases it after two seconds without a pose. */
#ifndef TROCAR_TRACKED_H
#define TROCAR_TRACKED_H

#include <lcm/lcm.h>
#include <pthread.h>
#include <stdbool.h>

#include "base/report.h"
#include "base/vec.h"

typedef struct {
    const char *url;         /* LCM's */
    int needle;              /* which one */
    pthread_t thread;
    pthread_mutex_t lock;    /* protects the following members */
    pthread_cond_t news;
    bool ends;
    int64_t heard;           /* ns, monotonic: arrival of the newest pose; 0 if the needle is not held */
    double period;           /* s between the last two poses */
    pose from, to;           /* the needle's pose when the newest pose arrived, and its destination */
} tracked_needle;

/* Starts the thread; the needle is not held before the first pose. SYSTEM. */
trocar_status tracked_needle_open(tracked_needle *t, const char *url, int needle, report *why);
void tracked_needle_close(tracked_needle *t); /* releases the needle */

/* Takes a new pose of the needle's base, m. */
void tracked_needle_move(tracked_needle *t, pose base);

typedef struct {
    lcm_t *lcm;
    int64_t session, seq;
} tracked_probe;

void tracked_probe_open(tracked_probe *p, lcm_t *lcm);
void tracked_probe_move(tracked_probe *p, pose base);

#endif
