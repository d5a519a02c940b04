/* Makes a needle of the server follow a tracker, and the probe follow a tracker or stepper. A tracker sends 20 to 100 poses a second, but the server needs one
   every few milliseconds, so a thread interpolates between the tracker's poses, lagging by one tracker period. The needle is held from the first pose on, kept
   still while poses are missing, and released after two seconds without a pose. */
#ifndef TROCAR_TRACKED_H
#define TROCAR_TRACKED_H

#include <lcm/lcm.h>
#include <pthread.h>
#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"

typedef struct {
    const char *url;         /* LCM URL; NULL for LCM's default */
    int needle;              /* index of the needle in the scene */
    pthread_t thread;
    pthread_mutex_t lock;    /* protects the following members */
    pthread_cond_t news;
    bool ends;
    int64_t heard;           /* ns, monotonic: arrival time of the newest pose; 0 if the needle is not held */
    double period;           /* s, time between the last two poses */
    pose from, to;           /* where the needle was when the newest pose arrived, and where it is moving to */
} tracked_needle;

/* Starts the thread. The needle is not held until the first pose arrives. SYSTEM. */
trocar_status tracked_needle_open(tracked_needle *t, const char *url, int needle, trocar_error *why);
void tracked_needle_close(tracked_needle *t); /* releases the needle */

/* Takes a new pose of the needle's base (positions in m). */
void tracked_needle_move(tracked_needle *t, pose base);

typedef struct {
    lcm_t *lcm;
    int64_t session, seq;
} tracked_probe;

void tracked_probe_open(tracked_probe *p, lcm_t *lcm);
void tracked_probe_move(tracked_probe *p, pose base);

#endif
