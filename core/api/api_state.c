/* Implements saving and restoring (trocar/sim.h). Runs between lockstep steps, where one thread is both the ticking thread and the worker. */
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "api/worker_answer.h"
#include "api/worker_probe.h"
#include "api/worker_resting.h"
#include "base/flush_denormals.h"
#include "base/hash.h"
#include "saved/saved_state.h"

/* The header of a saved state. It is always copied, because the caller's memory need not be aligned. */
typedef struct {
    char mark[8];            /* MARK, which identifies a saved state */
    uint64_t layout;         /* saved_layout() of the library that saved the state */
    uint64_t model;          /* checksum of the model */
    uint64_t size;           /* bytes, including this header */
    uint64_t checksum;       /* checksum of the bytes after this header */
} state_header;

static const char MARK[8] = {'t', 'r', 'o', 'c', 'a', 'r', '\1', '\2'};

/* What has to be saved of a needle in addition to its insertion state. */
typedef struct {
    int phase;
    double base_compliance;
    int64_t since_release;
} saved_needle;

enum { MOST_OTHER = 4096 };  /* bytes, upper bound on the parts of a state that trocar_sim_state_size does not count individually */

size_t trocar_sim_state_size(const trocar_sim *sim) {
    size_t of_needle = sizeof(saved_needle) + sizeof(insertion_state) + sizeof(compliance_snapshot) + sizeof(resting_needle) + (sim->probe ? sizeof(needle_hold) : 0);
    return sizeof(state_header) + sizeof(seed_list) + (size_t)sim->needle_count * of_needle + sizeof(probe_state) + changing_state_size() + elasticity_state_size() + MOST_OTHER;
}

size_t trocar_state_bytes(const void *state) {
    state_header header;
    memcpy(&header, state, sizeof header);
    return (size_t)header.size;
}

/* ---- saving ----------------------------------------------------------------------------------------------------------------------- */

static void save_needle(state_stream *to, const trocar_sim *sim, int index) {
    sim_needle *needle = &sim->needles[index];
    needle_phase phase = link_phase(&needle->link) == PHASE_TAKEN ? PHASE_HELD : link_phase(&needle->link);
    saved_needle saved = {.phase = (int)phase, .base_compliance = needle->base_compliance, .since_release = atomic_load(&needle->link.since_release)};
    const insertion_state *state = phase == PHASE_LEAVING ? &link_left(&needle->link)->state : state_of_needle(sim, index, NULL);
    int segments = sim->model->parts.needle.given.segments;
    STREAM(to, saved);
    saved_insertion(to, segments, (insertion_state *)state);
    saved_snapshot(to, (compliance_snapshot *)link_answer(&needle->link, state->request.insertion));
    if (phase == PHASE_RESTING || phase == PHASE_TAKING) saved_resting(to, segments, needle->resting);
}

trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_sim *s = (trocar_sim *)sim; /* the stream functions take non-const pointers, but an output stream does not write to them */
    state_header header = {.layout = saved_layout(), .model = sim->model->checksum};
    state_stream to = stream_to(state, size);
    STREAM(&to, header);
    STREAM(&to, s->since_response);
    STREAM(&to, s->rounds);
    changing_save(&to, &s->model->parts, s->changing);
    elasticity_save(&to, &s->elasticity, s->model);
    saved_seeds(&to, s->needle_count, &s->seeds);
    for (int i = 0; i < s->needle_count; i++) save_needle(&to, s, i);
    save_probe(&to, s);
    if (to.failed)
        return fail(why, TROCAR_BAD_INPUT, "the state of this simulation does not fit in %zu bytes: it takes up to %zu (trocar_sim_state_size)", size,
                    trocar_sim_state_size(sim));
    memcpy(header.mark, MARK, sizeof MARK);
    header.size = (uint64_t)(to.at - (char *)state);
    header.checksum = hash_bytes(HASH_BASIS, (char *)state + sizeof header, (size_t)header.size - sizeof header);
    memcpy(state, &header, sizeof header);
    return TROCAR_OK;
}

trocar_status sim_save_new(const trocar_sim *sim, void **state, size_t *bytes, trocar_error *why) {
    size_t most = trocar_sim_state_size(sim);
    void *saved = malloc(most);
    *state = NULL;
    if (!saved) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation's state");
    trocar_status status = trocar_sim_save(sim, saved, most, why);
    if (status != TROCAR_OK) {
        free(saved);
        return status;
    }
    *bytes = trocar_state_bytes(saved);
    void *shrunk = realloc(saved, *bytes);
    *state = shrunk ? shrunk : saved;
    return TROCAR_OK;
}

/* ---- restoring -------------------------------------------------------------------------------------------------------------------- */

static trocar_status check_state(const trocar_sim *sim, const void *state, size_t size, trocar_error *why) {
    state_header header;
    if (size < sizeof header) return fail(why, TROCAR_BAD_INPUT, "%zu bytes are too few for a saved state", size);
    memcpy(&header, state, sizeof header);
    if (memcmp(header.mark, MARK, sizeof MARK) != 0) return fail(why, TROCAR_BAD_INPUT, "this is not a state saved by trocar_sim_save");
    if (header.layout != saved_layout())
        return fail(why, TROCAR_BAD_INPUT, "the state was saved by a version of the library with another format: save it again with this version, %d.%d.%d",
                    TROCAR_MAJOR, TROCAR_MINOR, TROCAR_PATCH);
    if (header.model != sim->model->checksum)
        return fail(why, TROCAR_BAD_INPUT, "the state belongs to another model (checksum %016llx, not %016llx): restore it with the scene and mesh with which it was saved",
                    (unsigned long long)header.model, (unsigned long long)sim->model->checksum);
    if (header.size < sizeof header || header.size > size)
        return fail(why, TROCAR_BAD_INPUT, "the saved state has %llu bytes, of which only %zu are given", (unsigned long long)header.size, size);
    if (hash_bytes(HASH_BASIS, (const char *)state + sizeof header, (size_t)header.size - sizeof header) != header.checksum)
        return fail(why, TROCAR_BAD_INPUT, "the saved state is damaged: its bytes do not match their checksum");
    return TROCAR_OK;
}

/* Finds or builds a model with the moduli in `config`. The caller owns the returned reference. */
static trocar_status model_with(trocar_sim *sim, const simulation_config *config, trocar_model **found, trocar_error *why) {
    trocar_model *const known[] = {sim->model, sim->elasticity.to.model, sim->elasticity.from.model};
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        if (!same_elasticity(&known[i]->parts.config, config)) continue;
        *found = model_share(known[i]);
        return TROCAR_OK;
    }
    return model_stiffen(sim->model, config, NULL, found, why);
}

static trocar_status restore_moduli(state_stream *from, trocar_sim *sim, trocar_error *why) {
    trocar_model *models[2] = {NULL, NULL};
    saved_elasticity *saved = malloc(sizeof *saved);
    if (!saved) return fail(why, TROCAR_NO_MEMORY, "no memory for a saved state");
    saved->config[0] = saved->config[1] = sim->model->parts.config;
    elasticity_read(from, saved);
    trocar_status status = model_with(sim, &saved->config[0], &models[0], why);
    if (status == TROCAR_OK && saved->moves) status = model_with(sim, &saved->config[1], &models[1], why);
    else if (status == TROCAR_OK) models[1] = model_share(models[0]);
    if (status == TROCAR_OK) {
        moduli before[] = {sim->elasticity.from, sim->elasticity.to};
        elasticity_resume(&sim->elasticity, saved, moduli_of(models[0]), moduli_of(models[1]), sim->mixed, sim->changing);
        if (sim->pairs) needle_pairs_soften(sim->pairs);
        for (int i = 0; i < 2; i++) trocar_model_free(before[i].model);
    } else {
        trocar_model_free(models[0]);
    }
    free(saved);
    return status;
}

/* Restores everything about a needle except its remesher, which has to wait until the resting needles are attached. */
static trocar_status restore_needle(state_stream *from, trocar_sim *sim, sim_needle *needle, trocar_error *why) {
    saved_needle saved;
    int segments = sim->model->parts.needle.given.segments;
    STREAM(from, saved);
    saved_insertion(from, segments, &needle->state);
    saved_snapshot(from, link_answer_slot(&needle->link));
    needle->base_compliance = saved.base_compliance;
    needle->stamp = next_stamp();
    needle->given = needle->state.needle.base;
    needle->given.position = v3_sub(needle->given.position, needle->state.base_shift);
    needle->loads.count = 0;
    needle->attached = saved.phase == PHASE_RESTING || saved.phase == PHASE_TAKING;
    link_restore(&needle->link, (needle_phase)saved.phase, saved.since_release);
    if (!needle->attached) {
        insertion_add_loads(ticking_model(sim), &needle->state, &needle->loads);
        copy_loads(&needle->loads, &needle->held);
        link_post_loads(&needle->link, &needle->loads); /* replaces any loads posted before the restore */
        return TROCAR_OK;
    }
    trocar_status status = make_room_to_rest(sim, needle, why);
    if (status != TROCAR_OK) return status;
    saved_resting(from, segments, needle->resting);
    needle->held.count = 0;
    insertion_add_residual_loads(ticking_model(sim), &needle->resting->anchor, &needle->held);
    return TROCAR_OK;
}

/* Any work that was pending when the state was saved is pending again after the restore. */
trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    state_header header;
    trocar_status status = check_state(sim, state, size, why);
    if (status != TROCAR_OK) return status;
    state_stream from = stream_from(state, trocar_state_bytes(state));
    floating_mode before = flush_denormals();
    STREAM(&from, header);
    STREAM(&from, sim->since_response);
    STREAM(&from, sim->rounds);
    status = changing_restore(&from, &sim->model->parts, &sim->changing, why);
    if (status == TROCAR_OK) status = restore_moduli(&from, sim, why);
    saved_seeds(&from, sim->needle_count, &sim->seeds);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) status = restore_needle(&from, sim, &sim->needles[i], why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++)
        /* needs a loop of its own, because fill_message_of_left_needle uses the tracks of all needles */
        if (link_phase(&sim->needles[i].link) == PHASE_LEAVING) fill_message_of_left_needle(sim, i), link_publish_left(&sim->needles[i].link);
    if (status == TROCAR_OK) status = rest_again(sim, why);
    if (status == TROCAR_OK) status = restore_probe(&from, sim, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        sim_needle *needle = &sim->needles[i];
        needle->served_changes = attached_changes(sim);
        needle->softened = sim->elasticity.moves;
        needle->served_shifts = attached_shifts(sim);
        status = remesher_resume(needle->remesher, &needle->state.request, link_answer_slot(&needle->link), why);
        link_publish_answer(&needle->link);
    }
    restore_floating_mode(before);
    return status;
}
