/* Plays the figure-8 motion in lockstep and measures how far two runs differ. */
#ifndef TROCAR_TESTS_FIGURE8_H
#define TROCAR_TESTS_FIGURE8_H

#include "lockstep.h"
#include "shared/motion.h"

/* Bounds for recording the force and torque of every tick of the figure-8 motion. */
enum { FIGURE8_MOST_TICKS = 2400 * 4 };
static const double FIGURE8_DURATION = 2.4, FIGURE8_SLOWEST_PERIOD = 4e-3; /* s */

typedef struct {
    double rate;
    int ticks, punctures;
    double worst_jump;       /* largest change in force per tick, as a multiple of the limit max(7 %, 0.05 N), except close to punctures */
    unsigned events;
    double wrench[FIGURE8_MOST_TICKS][6];
} figure8_record;

/* With `every_serve`, the worker answers only once in this many ticks. */
static inline figure8_record *figure8_run_by(remesh_method method, const simulation_config *config, double rate, int every_serve) {
    figure8_record *r = calloc(1, sizeof *r);
    lockstep *l = lockstep_create(config, lockstep_start());
    lockstep_remesh_by(l, method);
    const motion *script = motion_find("figure8");
    vec3 last = v3(0, 0, 0);
    double quiet = 0.0;
    r->rate = rate;
    r->ticks = (int)(FIGURE8_DURATION * rate + 0.5);
    for (int i = 0; i < r->ticks; i++) {
        double t = (i + 1) / rate;
        trocar_error why;
        insertion_tick(&(tick_input){.model = &l->parts.insertion, .snapshot = l->snapshot, .base = {.pose = motion_pose(script, lockstep_start(), t)}, .dt = 1 / rate},
                       &l->state, l->run.workspace, &l->wrench);
        if (l->snapshot->serial != l->state.request.serial && i % every_serve == 0
            && remesher_answer(l->run.remesher, &l->state.request, l->snapshot, &why) != TROCAR_OK) {
            fprintf(stderr, "%s\n", why.text);
            abort();
        }
        bool punctured = l->wrench.events & EVENT_PUNCTURED;
        r->events |= l->wrench.events;
        r->punctures += punctured;
        quiet = punctured ? 0.0 : quiet + 1 / rate;
        double jump = v3_norm(v3_sub(l->wrench.force, last)), allowed = fmax(0.05, 0.07 * v3_norm(last));
        if (quiet > 1.5e-3) r->worst_jump = fmax(r->worst_jump, jump / allowed);
        last = l->wrench.force;
        memcpy(r->wrench[i], &l->wrench.force, sizeof(vec3));
        memcpy(r->wrench[i] + 3, &l->wrench.torque, sizeof(vec3));
    }
    lockstep_free(l);
    return r;
}

static inline figure8_record *figure8_run(const simulation_config *config, double rate, int every_serve) {
    return figure8_run_by(REMESH_NESTED, config, rate, every_serve);
}

static inline double figure8_peak(const figure8_record *r, int from, int to) {
    double largest = 0.0;
    for (int i = 0; i < r->ticks; i++)
        for (int a = from; a < to; a++) largest = fmax(largest, fabs(r->wrench[i][a]));
    return largest;
}

/* Compares the components [from, to) of a with those of b at the same time or up to `shift` s earlier or later, because punctures may fall in neighbouring
   ticks. Returns the largest difference, relative to b's peak. */
static inline double figure8_difference(const figure8_record *a, const figure8_record *b, int from, int to, double shift) {
    double largest = 0.0;
    for (int i = 0; i < a->ticks; i++) {
        double t = (i + 1) / a->rate, nearest = INFINITY;
        int middle = (int)(t * b->rate + 0.5) - 1, reach = (int)(shift * b->rate + 0.5);
        for (int j = middle - reach < 0 ? 0 : middle - reach; j <= middle + reach && j < b->ticks; j++) {
            double off = 0.0;
            for (int k = from; k < to; k++) off = fmax(off, fabs(a->wrench[i][k] - b->wrench[j][k]));
            nearest = fmin(nearest, off);
        }
        largest = fmax(largest, nearest);
    }
    return largest / figure8_peak(b, from, to);
}

#endif
