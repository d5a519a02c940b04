#include "tracked.h"

#include <errno.h>
#include <string.h>
#include <time.h>

#include "common/messages.h"
#include "common/session.h"
#include "common/timing.h"
#include "trocar_client.h"
#include "trocar_probe_pose_t.h"

static const int64_t STEP = 2000000;        /* ns, interval between poses sent to the server */
static const int64_t SILENCE = 2000000000;  /* ns, release the needle after this long without poses from the tracker; the server uses the same time */
static const int64_t DEAF = 1000000000;     /* ns, tell the user after this long without wrenches for this needle */
static const double LONGEST_PERIOD = 0.1;   /* s: a longer gap between poses means that tracking was interrupted */

/* Returns the interpolated pose, on the way to the tracker's newest pose. */
static pose pose_now(const tracked_needle *t, int64_t now) {
    return pose_between(t->from, t->to, fmin(1, 1e-9 * (double)(now - t->heard) / t->period));
}

void tracked_needle_move(tracked_needle *t, pose base) {
    int64_t now = monotonic_ns();
    pthread_mutex_lock(&t->lock);
    t->from = t->heard ? pose_now(t, now) : base;
    t->period = t->heard ? fmin(fmax(1e-9 * (double)(now - t->heard), 1e-3), LONGEST_PERIOD) : LONGEST_PERIOD;
    t->to = base;
    t->heard = now;
    pthread_cond_signal(&t->news);
    pthread_mutex_unlock(&t->lock);
}

/* Waits for a pose from the tracker. Returns false if the thread should end. */
static bool wait_for_pose(tracked_needle *t) {
    pthread_mutex_lock(&t->lock);
    while (!t->heard && !t->ends) pthread_cond_wait(&t->news, &t->lock);
    bool goes_on = !t->ends;
    pthread_mutex_unlock(&t->lock);
    return goes_on;
}

/* Computes the next pose for the server. Returns false if the tracker has been silent for too long, or if the thread should end. */
static bool next_pose(tracked_needle *t, int64_t now, pose *p) {
    pthread_mutex_lock(&t->lock);
    bool lost = now - t->heard > SILENCE;
    if (lost) t->heard = 0;
    bool goes_on = !lost && !t->ends;
    if (goes_on) *p = pose_now(t, now);
    pthread_mutex_unlock(&t->lock);
    return goes_on;
}

static void hold(tracked_needle *t, trocar_client *server) {
    bool deaf = false;
    int64_t due = monotonic_ns(), answered = due;
    pose p;
    for (; next_pose(t, monotonic_ns(), &p); sleep_until(due)) {
        trocar_pose sent = library_pose(p);
        trocar_client_wrench wrench;
        trocar_client_publish(server, sent.position, sent.orientation);
        if (trocar_client_newest(server, &wrench)) answered = due;
        bool was_deaf = deaf;
        deaf = due - answered > DEAF;
        if (deaf && !was_deaf) fprintf(stderr, "trocar-slicer: the server does not accept the tracked needle: trocar-top shows whether it is held elsewhere, or why poses are refused\n");
        if (!deaf && was_deaf) fprintf(stderr, "trocar-slicer: the server accepts the tracked needle\n");
        due += STEP;
        if (due < monotonic_ns()) due = monotonic_ns();
    }
}

static void *run(void *context) {
    tracked_needle *t = context;
    const trocar_client_options options = {.url = t->url, .needle = t->needle, .without_force = 1};
    while (wait_for_pose(t)) {
        trocar_client *server = trocar_client_open(&options, NULL, 0);
        if (!server) {
            sleep_until(monotonic_ns() + DEAF);
            continue;
        }
        fprintf(stderr, "trocar-slicer: the tracker holds needle %d\n", t->needle);
        hold(t, server);
        trocar_client_close(server);
        fprintf(stderr, "trocar-slicer: no poses from the tracker: needle %d is released\n", t->needle);
    }
    return NULL;
}

trocar_status tracked_needle_open(tracked_needle *t, const char *url, int needle, trocar_error *why) {
    *t = (tracked_needle){.url = url, .needle = needle};
    pthread_mutex_init(&t->lock, NULL);
    pthread_cond_init(&t->news, NULL);
    int error = pthread_create(&t->thread, NULL, run, t);
    return error == 0 ? TROCAR_OK : fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(error));
}

void tracked_needle_close(tracked_needle *t) {
    pthread_mutex_lock(&t->lock);
    t->ends = true;
    pthread_cond_signal(&t->news);
    pthread_mutex_unlock(&t->lock);
    pthread_join(t->thread, NULL);
}

void tracked_probe_open(tracked_probe *p, lcm_t *lcm) {
    *p = (tracked_probe){.lcm = lcm, .session = session_new()};
}

void tracked_probe_move(tracked_probe *p, pose base) {
    trocar_probe_pose_t m = {.utime = wall_us(), .session = p->session, .seq = p->seq++};
    trocar_pose sent = library_pose(base);
    memcpy(m.position, sent.position, sizeof m.position);
    memcpy(m.orientation, sent.orientation, sizeof m.orientation);
    trocar_probe_pose_t_publish(p->lcm, "TROCAR_PROBE", &m);
}
