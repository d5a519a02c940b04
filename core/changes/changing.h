/* The values in a simulation that may change during a run: one set for the ticking thread, one for the worker. */
#ifndef TROCAR_CHANGING_H
#define TROCAR_CHANGING_H

#include "base/triple_buffer.h"
#include "changes/run_values.h"
#include "saved/state_stream.h"

typedef struct {
    values_in_use ticking;   /* used by the ticking thread */
    values_in_use worker;    /* used by the worker when it releases needles; has a change's final values from its beginning */
    triple_buffer changes;   /* run_values: ticking thread -> worker */
} sim_changing;

/* Allocates both sets, with the model's values. NO_MEMORY. */
trocar_status changing_create(const model_parts *parts, sim_changing **changing, trocar_error *why);
void changing_free(sim_changing *c);

/* Begins a change in the ticking thread, at `time` (s, simulated), and posts it to the worker. RT */
void changing_begin(sim_changing *c, const run_values *to, double time, double duration);

/* Gives the worker the newest values. The worker calls this before its other work. */
void changing_take(sim_changing *c);

/* Saves or restores the values; see saved_state.h. If `c` or *changing is NULL, they are the model's. */
size_t changing_state_size(void);
void changing_save(state_stream *to, const model_parts *parts, sim_changing *c);
trocar_status changing_restore(state_stream *from, const model_parts *parts, sim_changing **changing, trocar_error *why);

#endif
