#include "changes/changing.h"

#include "base/cache_line.h"

trocar_status changing_create(const model_parts *parts, sim_changing **changing, trocar_error *why) {
    sim_changing *c = allocate_on_cache_lines(sizeof *c);
    if (!c) return fail(why, TROCAR_NO_MEMORY, "no memory for the values of a simulation");
    trocar_status status = triple_buffer_create(&c->changes, sizeof(run_values), why);
    if (status != TROCAR_OK) {
        free(c);
        return status;
    }
    values_begin(parts, &c->ticking);
    values_begin(parts, &c->worker);
    *changing = c;
    return TROCAR_OK;
}

void changing_free(sim_changing *c) {
    if (!c) return;
    triple_buffer_free(&c->changes);
    free(c);
}

void changing_begin(sim_changing *c, const run_values *to, double time, double duration) {
    values_change(&c->ticking, to, time, duration);
    *(run_values *)triple_buffer_slot(&c->changes) = *to;
    triple_buffer_publish(&c->changes);
}

void changing_take(sim_changing *c) {
    bool fresh;
    if (!c) return;
    const run_values *newest = triple_buffer_read(&c->changes, &fresh);
    if (fresh) values_set(&c->worker, newest);
}

/* ---- saved states ------------------------------------------------------------------------------------------------------------ */

size_t changing_state_size(void) { return sizeof(int) + sizeof(values_in_use); }

/* Writes the array entries that the model uses to a stream, or reads them from it. */
static void pass_values(state_stream *s, const model_parts *parts, run_values *v) {
    STREAM_ENTRIES(s, v->materials, parts->mesh.group_count);
    STREAM_ENTRIES(s, v->membranes, parts->config.membrane_count);
    STREAM_ENTRIES(s, v->sheets, parts->config.membrane_count);
    STREAM_ENTRIES(s, v->calcifications, parts->config.calcification_count);
    STREAM_ENTRIES(s, v->guides, parts->config.guide_count);
}

static void pass_change(state_stream *s, const model_parts *parts, values_in_use *v) {
    pass_values(s, parts, &v->now);
    pass_values(s, parts, &v->from);
    pass_values(s, parts, &v->to);
    STREAM(s, v->duration);
    STREAM(s, v->part);
    STREAM(s, v->time);
}

void changing_save(state_stream *to, const model_parts *parts, sim_changing *c) {
    int changed = c && c->ticking.duration > 0.0;
    stream_count(to, &changed, 1);
    if (changed) pass_change(to, parts, &c->ticking);
}

trocar_status changing_restore(state_stream *from, const model_parts *parts, sim_changing **changing, trocar_error *why) {
    int changed;
    stream_count(from, &changed, 1);
    if (!*changing && !changed) return TROCAR_OK;
    trocar_status status = *changing ? TROCAR_OK : changing_create(parts, changing, why);
    if (status != TROCAR_OK) return status;
    sim_changing *c = *changing;
    values_begin(parts, &c->ticking);
    values_begin(parts, &c->worker);
    triple_buffer_read(&c->changes, NULL); /* discard any change posted before the restore */
    if (!changed) return TROCAR_OK;
    pass_change(from, parts, &c->ticking);
    values_set(&c->worker, &c->ticking.to);
    return TROCAR_OK;
}
