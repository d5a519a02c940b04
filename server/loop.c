#include "loop.h"

#include <string.h>

/* Adds one tick to the timing of the current interval, which is kept in the buffer's write slot. RT */
static void note(loop *l, int64_t lateness, int64_t compute) {
    loop_record *interval = triple_buffer_slot(l->records);
    histogram_add(&interval->lateness, lateness);
    histogram_add(&interval->compute, compute);
    histogram_add(&l->lateness, lateness);
    histogram_add(&l->compute, compute);
    for (int i = 0; l->stages != NULL && i < LOOP_STAGES; i++) {
        interval->stage_total[i] += l->stages[i];
        if (l->stages[i] > interval->stage_max[i]) interval->stage_max[i] = l->stages[i];
    }
}

/* Publishes the timing of the current interval and starts the next one. RT */
static void hand_over(loop *l) {
    loop_record *interval = triple_buffer_slot(l->records);
    interval->lateness_max_total = histogram_max(&l->lateness);
    interval->compute_max_total = histogram_max(&l->compute);
    interval->ticks = l->ticks;
    interval->misses = l->misses;
    interval->usage = l->usage;
    triple_buffer_publish(l->records);

    interval = triple_buffer_slot(l->records);
    histogram_clear(&interval->lateness);
    histogram_clear(&interval->compute);
    memset(interval->stage_total, 0, sizeof interval->stage_total);
    memset(interval->stage_max, 0, sizeof interval->stage_max);
}

void loop_run(loop *l) {
    int64_t period = (int64_t)(1e9 / l->rate_hz + 0.5), per_interval = (int64_t)(l->rate_hz / 10.0 + 0.5);
    thread_usage start = thread_usage_now();
    int64_t deadline = monotonic_ns() + period, missed = 0;
    phase_lock phase = {.period = period};
    bool running = true;

    while (running) {
        sleep_until(deadline);
        int64_t woke = monotonic_ns();
        running = l->tick(l->context, &(loop_wake){.tick = l->ticks, .now = woke, .late = missed > 0,
                                                   .elapsed = 1e-9 * (double)(period * (1 + missed))});
        int64_t ended = monotonic_ns();
        note(l, woke - deadline, ended - woke);

        missed = (ended - deadline) / period;
        int64_t shift = l->received != NULL ? phase_lock_shift(&phase, deadline, *l->received) : 0;
        deadline += (1 + missed) * period + shift;
        l->misses += missed;
        l->ticks++;
        if (l->ticks % (10 * per_interval) == 0) l->usage = thread_usage_since(&start);
        if (l->ticks % per_interval == 0) hand_over(l);
    }
    l->usage = thread_usage_since(&start);
}
