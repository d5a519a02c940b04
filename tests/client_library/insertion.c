/* A test bridge in C99, for any system that trocar_client.h supports. Resets the needle, pushes it in by 21 mm at 10 mm/s, and holds it for half a second.
   With SECONDS, it only holds still in front of the skin for that long. Prints the measured values, one number with its name per line. Writes a line to FILE
   for each period: the time before and after it gets a wrench (s), the wrench's tick (0: none), its force (N) and its torque (N m).
   usage: insertion URL [SECONDS [FILE]] */
#ifndef _WIN32
#define _DEFAULT_SOURCE
#endif
#include "trocar_client.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>

static double now(void) {
    LARGE_INTEGER count, rate;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&rate);
    return (double)count.QuadPart / (double)rate.QuadPart;
}

static void wait_for_period(void) { Sleep(1); }
#else
#include <time.h>

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void wait_for_period(void) {
    struct timespec t = {0, 1000000};
    nanosleep(&t, NULL);
}
#endif

static const double START = -0.201, WAY = 0.021, SPEED = 0.01; /* m, m, m/s */

static double length_of(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

typedef struct {
    trocar_client_wrench wrench;
    double force, most; /* N, the last and the largest */
    long periods, answered, outages, back; /* `back`: returns to an older wrench */
    int was_answered;
} felt_so_far;

static FILE *trace;

static void exchange(trocar_client *c, double advance, felt_so_far *f) {
    const double position[3] = {0.005, 0.003, START + advance}, orientation[4] = {1, 0, 0, 0};
    trocar_client_wrench w;
    wait_for_period();
    trocar_client_publish(c, position, orientation);
    double before = now();
    int answered = trocar_client_newest(c, &w);
    double after = now(), force = length_of(w.force);
    if (trace != NULL) fprintf(trace, "%.7f %.7f %.0f %.12g %.12g\n", before, after, (double)w.tick, force, length_of(w.torque));
    f->periods++;
    f->answered += answered;
    f->outages += f->was_answered && !answered;
    f->back += answered && f->was_answered && w.tick < f->wrench.tick;
    if (force > f->most) f->most = force;
    f->force = force;
    f->wrench = w;
    f->was_answered = answered;
}

/* Resets the needle. Returns how many times the command had to be sent before the server replied. */
static int reset(trocar_client *c, felt_so_far *f) {
    for (int times = 1; times <= 5; times++) {
        trocar_client_reset(c);
        while (trocar_client_reply(c, NULL, 0) == TROCAR_CLIENT_WAITING) exchange(c, 0, f);
        if (trocar_client_reply(c, NULL, 0) == TROCAR_CLIENT_DONE) return times;
    }
    return 0;
}

int main(int count, char **arguments) {
    trocar_client_options options = trocar_client_default_options();
    felt_so_far before = {0}, felt = {0};
    if (count < 2 || count > 4) return 2;
    if (count == 4 && (trace = fopen(arguments[3], "w")) == NULL) return 2;
    options.url = arguments[1];
    trocar_client *c = trocar_client_open(&options, NULL, 0);
    if (c == NULL) return 1;
    if (count > 2) {
        for (double end = now() + atof(arguments[2]); now() < end;) exchange(c, 0, &felt);
    } else {
        for (double end = now() + 10; !before.was_answered && now() < end;) exchange(c, 0, &before);
        printf("resets %d\n", reset(c, &before));
        for (double begin = now(), t = -0.5; t < 0.5 + WAY / SPEED; t = now() - begin - 0.5) /* first rests for half a second, until the force's ramp ends */
            exchange(c, t < 0 ? 0 : t < WAY / SPEED ? SPEED * t : WAY, &felt);
    }
    printf("periods %ld\nanswered %ld\noutages %ld\nback %ld\n", felt.periods, felt.answered, felt.outages, felt.back);
    printf("force %.6f\nmost %.6f\ndepth %.6f\nstate %d\n", felt.force, felt.most, felt.wrench.depth, (int)trocar_client_get_state(c, NULL, 0));
    trocar_client_close(c);
    if (trace != NULL) fclose(trace);
    return 0;
}
