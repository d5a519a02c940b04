/* trocar.h: saving and restoring a simulation. Called between lockstep steps, where one thread is both ticking thread and worker. */
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "api/worker_answer.h"
#include "api/worker_probe.h"
#include "api/worker_resting.h"
#include "base/flush_denormals.h"

/* Data saved for each needle. The model's address, the time of the last response, the simulated time and the seeds precede it. It is copied member by
   member, because the caller's memory need not be aligned. The worker's pending work is completed after a restore. */
typedef struct {
    int phase;
    insertion_state state;   /* state of the needle; if it is being left, its state at that moment */
    double base_compliance;
    int64_t since_release;
    compliance_snapshot snapshot;
    resting_needle resting;  /* valid while the needle is attached */
} saved_needle;

enum { ROUNDS_AT = sizeof(trocar_model *) + sizeof(double), SEEDS_AT = ROUNDS_AT + sizeof(round_clock), HEAD = SEEDS_AT + sizeof(seed_list) };

size_t trocar_sim_state_size(const trocar_sim *sim) { return HEAD + (size_t)sim->needle_count * sizeof(saved_needle) + saved_probe_size(sim); }

static trocar_status check_size(const trocar_sim *sim, size_t size, report *why) {
    size_t expected = trocar_sim_state_size(sim);
    return size == expected ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "the state of this simulation has %zu bytes, not %zu", expected, size);
}

static void save_needle(const trocar_sim *sim, int index, char *to) {
    sim_needle *needle = &sim->needles[index];
    int phase = link_phase(&needle->link) == PHASE_TAKEN ? PHASE_HELD : link_phase(&needle->link);
    const insertion_state *state = phase == PHASE_LEAVING ? &link_left(&needle->link)->state : state_of_needle(sim, index, NULL);
    memcpy(to + offsetof(saved_needle, phase), &phase, sizeof phase);
    memcpy(to + offsetof(saved_needle, state), state, sizeof *state);
    memcpy(to + offsetof(saved_needle, base_compliance), &needle->base_compliance, sizeof needle->base_compliance);
    int64_t since_release = atomic_load(&needle->link.since_release);
    memcpy(to + offsetof(saved_needle, since_release), &since_release, sizeof since_release);
    memcpy(to + offsetof(saved_needle, snapshot), link_answer(&needle->link), sizeof(compliance_snapshot));
    if (phase == PHASE_RESTING || phase == PHASE_TAKING) memcpy(to + offsetof(saved_needle, resting), needle->resting, sizeof *needle->resting);
}

trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error) {
    trocar_error ignored;
    trocar_status status = check_size(sim, size, error ? error : &ignored);
    if (status != TROCAR_OK) return status;
    memcpy(state, &sim->model, sizeof sim->model);
    memcpy((char *)state + sizeof sim->model, &sim->since_response, sizeof sim->since_response);
    memcpy((char *)state + ROUNDS_AT, &sim->rounds, sizeof sim->rounds);
    memcpy((char *)state + SEEDS_AT, &sim->seeds, sizeof sim->seeds);
    for (int i = 0; i < sim->needle_count; i++) save_needle(sim, i, (char *)state + HEAD + (size_t)i * sizeof(saved_needle));
    save_probe((trocar_sim *)sim, (char *)state + HEAD + (size_t)sim->needle_count * sizeof(saved_needle));
    return TROCAR_OK;
}

/* Restores everything except the remesher, which can be restored only after the resting needles have been attached. */
static trocar_status restore_needle(trocar_sim *sim, sim_needle *needle, const char *from, report *why) {
    int phase;
    compliance_snapshot *slot = link_answer_slot(&needle->link);
    memcpy(&phase, from + offsetof(saved_needle, phase), sizeof phase);
    memcpy(&needle->state, from + offsetof(saved_needle, state), sizeof needle->state);
    memcpy(&needle->base_compliance, from + offsetof(saved_needle, base_compliance), sizeof needle->base_compliance);
    int64_t since_release;
    memcpy(&since_release, from + offsetof(saved_needle, since_release), sizeof since_release);
    memcpy(slot, from + offsetof(saved_needle, snapshot), sizeof *slot);
    needle->stamp = next_stamp();
    needle->given = needle->state.needle.base;
    needle->given.position = v3_sub(needle->given.position, needle->state.base_shift);
    needle->loads.count = 0;
    needle->attached = phase == PHASE_RESTING || phase == PHASE_TAKING;
    link_restore(&needle->link, (needle_phase)phase, since_release);
    if (!needle->attached) {
        insertion_add_loads(&sim->model->parts.insertion, &needle->state, &needle->loads);
        copy_loads(&needle->loads, &needle->held);
        link_post_loads(&needle->link, &needle->loads); /* replaces loads posted before the restore */
        return TROCAR_OK;
    }
    trocar_status status = make_room_to_rest(sim, needle, why);
    if (status != TROCAR_OK) return status;
    memcpy(needle->resting, from + offsetof(saved_needle, resting), sizeof *needle->resting);
    needle->held.count = 0;
    insertion_add_residual_loads(&sim->model->parts.insertion, &needle->resting->anchor, &needle->held);
    return TROCAR_OK;
}

trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    const trocar_model *model;
    trocar_status status = check_size(sim, size, why);
    if (status != TROCAR_OK) return status;
    memcpy(&model, state, sizeof model);
    if (model != sim->model) return fail(why, TROCAR_BAD_INPUT, "the state belongs to another model");
    floating_mode before = flush_denormals();
    memcpy(&sim->since_response, (const char *)state + sizeof model, sizeof sim->since_response);
    memcpy(&sim->rounds, (const char *)state + ROUNDS_AT, sizeof sim->rounds);
    memcpy(&sim->seeds, (const char *)state + SEEDS_AT, sizeof sim->seeds);
    const char *from = (const char *)state + HEAD;
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++, from += sizeof(saved_needle)) status = restore_needle(sim, &sim->needles[i], from, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++)
        /* in a loop of its own, because fill_message_of_left_needle needs the tracks of all needles */
        if (link_phase(&sim->needles[i].link) == PHASE_LEAVING) fill_message_of_left_needle(sim, i), link_publish_left(&sim->needles[i].link);
    if (status == TROCAR_OK) status = rest_again(sim, why);
    if (status == TROCAR_OK) status = restore_probe(sim, from, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        sim_needle *needle = &sim->needles[i];
        needle->served_changes = attached_changes(sim);
        needle->served_shifts = attached_shifts(sim);
        status = remesher_resume(needle->remesher, &needle->state.request, link_answer_slot(&needle->link), why);
        link_publish_answer(&needle->link);
    }
    restore_floating_mode(before);
    return status;
}
