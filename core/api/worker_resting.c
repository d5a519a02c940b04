#include "api/worker_resting.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "api/worker_answer.h"
#include "api/worker_probe.h"
#include "base/cache_line.h"
#include "base/flush_denormals.h"

enum { MOST_TICKS = 2000 };            /* a released needle must come to rest within this many ticks: 2 s, enough for its shaft lag to decay */

/* A needle is at rest when the wrench left at its base and the largest slip of any contact per tick are below these limits. */
typedef struct { double force, torque, slip; } rest_limits; /* N, N m, m */
static const rest_limits AT_REST = {1e-3, 1e-4, 1e-7}, RELAXING = {20e-3, 2e-3, 2e-6}; /* wider, because relaxing tissue goes on creeping for seconds */

static const double LARGEST_STEP = 16.0; /* largest step of the base, relative to the step if nothing slid */
static const double TICK = 1e-3;       /* s */
static const double SHOWN = 1e-4;      /* N, change in force above which a needle is published again */
static const double SHOWN_ALL = 1e-7;  /* N, used instead of SHOWN when all needles are updated */
enum { SHOWN_AT_ONCE = 4 };            /* the worker computes the shapes of at most this many needles per pass */

/* ---- letting go ----------------------------------------------------------------------------------------------- */

static bool is_at_rest(const insertion_model *model, const insertion_state *state, const tick_output *wrench) {
    const rest_limits *limits = model->creep.count > 0 ? &RELAXING : &AT_REST;
    vec3 axis = q_axis(state->needle.base.orientation), across = v3_axpy(-v3_dot(wrench->torque, axis), axis, wrench->torque);
    double slip = fmax(fabs(state->tip.solved.slip), fabs(state->tip.shaft.slip));
    for (int k = 0; contact_is_active(state, k); k++) slip = fmax(slip, fabs(state->contacts[state->refined.order[k]].shaft.slip));
    return v3_norm(wrench->force) < limits->force && v3_norm(across) < limits->torque && slip < limits->slip;
}

/* Releases the base and moves it until its wrench vanishes. Then linearises the needle where it ended up, ready to be attached. */
static trocar_status release_base(trocar_sim *sim, int index, const track_list *others, insertion_state *state, trocar_error *why) {
    sim_needle *n = &sim->needles[index];
    resting_scratch *scratch = sim->resting_scratch;
    const compliance_snapshot *snapshot = link_answer_slot(&n->link); /* serves as scratch: the ticking thread does not tick the needle now */
    tick_output wrench;
    tick_input tick = {.model = worker_model(sim), .snapshot = snapshot, .dt = TICK, .base = {.pose = state->needle.base}, .others = {others}, .other_count = 1};
    state->base_shift = v3(0, 0, 0);
    insertion_soften(&tick, state, &scratch->workspace); /* if moduli are changing, the ticking thread may have been ahead of the worker */
    trocar_status status = answer_fully(sim, index, &state->request, why);
    double size = 1.0; /* step relative to the step if nothing slid; grows as long as sliding keeps the wrench from falling */
    vec3 before = v3(0, 0, 0);
    for (int i = 0; i < MOST_TICKS && status == TROCAR_OK; i++) {
        base_motion step;
        insertion_tick(&tick, state, &scratch->workspace, &wrench);
        if (state->moving_on || !insertion_is_finite(state, &wrench)) return fail(why, TROCAR_NUMERIC, "needle %d has no equilibrium without the hand", index);
        bool at_rest = is_at_rest(tick.model, state, &wrench) && state->request.serial == snapshot->serial;
        if (state->request.serial != snapshot->serial) status = answer_fully(sim, index, &state->request, why);
        if (status == TROCAR_OK) status = resting_linearise(&tick, state, sim->inverse, scratch, n->resting, why);
        if (status != TROCAR_OK || at_rest) return status;
        bool turned = v3_dot(wrench.force, before) < 0.0, falls = v3_norm(wrench.force) < 0.5 * v3_norm(before);
        size = turned ? 1.0 : falls ? size : fmin(2.0 * size, LARGEST_STEP);
        before = wrench.force;
        status = resting_release_step(n->resting, size, scratch, &step, why);
        if (status == TROCAR_OK) tick.base.pose = pose_moved(tick.base.pose, step);
    }
    if (status != TROCAR_OK) return status;
    return fail(why, TROCAR_NUMERIC, "needle %d does not come to rest without the hand: %.2g N remain at its base", index, v3_norm(wrench.force));
}

/* ---- what rests -------------------------------------------------------------------------------------------------- */

static int list_attached(const trocar_sim *sim, resting_needle *list[MAX_NEEDLES]) {
    int count = 0;
    for (int i = 0; i < sim->needle_count; i++)
        if (sim->needles[i].attached) list[count++] = sim->needles[i].resting;
    return count;
}

/* Reattaches all resting needles. Their forces do not change. */
static trocar_status attach_all(trocar_sim *sim, trocar_error *why) {
    resting_needle *list[MAX_NEEDLES];
    other_loads held;
    int count = list_attached(sim, list);
    atomic_store(&sim->link.resting, count);
    list_others(sim, BESIDE_RESTING, &held);
    mark_stale(sim, NULL);
    return resting_set_change(&sim->resting, count, list, &held, why);
}

/* Reattaches all resting needles after needles have been added or removed, and then presses the probe. */
static trocar_status attach_again(trocar_sim *sim, trocar_error *why) {
    trocar_status status = attach_all(sim, why);
    return status == TROCAR_OK ? press_probe(sim, why) : status;
}

/* Writes the needle's current state to the slot to be published next, and returns the slot. */
static const shown_needle *find_shown(trocar_sim *sim, sim_needle *n) {
    shown_needle *slot = link_shown_slot(&n->link);
    resting_show(worker_model(sim), n->resting, &sim->resting_scratch->workspace.response.tangent, &slot->state);
    slot->stamp = next_stamp();
    memcpy(n->shown_force, n->resting->force, sizeof n->shown_force);
    return slot;
}

static void show(trocar_sim *sim, sim_needle *n) {
    find_shown(sim, n);
    link_publish_shown(&n->link);
}

/* Publishes up to `most` needles whose forces differ from the published ones by more than `difference` (N). */
static void show_changed(trocar_sim *sim, double difference, int most) {
    for (int i = 0; i < sim->needle_count && most > 0; i++) {
        sim_needle *n = &sim->needles[sim->next_shown = (sim->next_shown + 1) % sim->needle_count];
        bool changed = false;
        for (int u = 0; n->attached && u < n->resting->unknown_count && !changed; u++) changed = fabs(n->resting->force[u] - n->shown_force[u]) > difference;
        if (changed) show(sim, n), most--;
    }
}

bool slip_some(trocar_sim *sim, bool all) {
    uint64_t before = sim->resting.shifts;
    if (sim->resting.count == 0) return false;
    bool more = resting_set_slip(&sim->resting, worker_model(sim), all ? INT_MAX : 1);
    if (sim->resting.shifts != before) mark_stale(sim, NULL);
    if (!more) show_changed(sim, all ? SHOWN_ALL : SHOWN, all ? MAX_NEEDLES : SHOWN_AT_ONCE);
    return more;
}

/* Returns the fraction of the last release's effect that the other needles do not feel yet. Time runs with the needle that has ticked the longest since the
   release. */
static double left_of_release(const trocar_sim *sim) {
    int64_t most = 0;
    for (int i = 0; i < sim->needle_count; i++) {
        int64_t since = atomic_load_explicit(&sim->needles[i].link.since_release, memory_order_relaxed);
        if (since > most) most = since;
    }
    return most < RELEASE_TIME ? 1.0 - (double)most / (double)RELEASE_TIME : 0.0;
}

trocar_status respond_to_loads(trocar_sim *sim, bool all, trocar_error *why) {
    other_loads held;
    if (sim->resting.count == 0) return TROCAR_OK;
    if (resting_set_fade(&sim->resting, left_of_release(sim))) mark_stale(sim, NULL);
    list_others(sim, BESIDE_RESTING, &held);
    uint64_t before = sim->resting.shifts;
    trocar_status status = resting_set_load(&sim->resting, &held, why);
    if (sim->resting.shifts != before) mark_stale(sim, NULL);
    if (status == TROCAR_OK && all) slip_some(sim, true);
    return status;
}

trocar_status make_room_to_rest(trocar_sim *sim, sim_needle *n, trocar_error *why) {
    if (!sim->resting_scratch) sim->resting_scratch = allocate_on_cache_lines(sizeof *sim->resting_scratch);
    if (!n->resting) n->resting = calloc(1, sizeof *n->resting);
    return sim->resting_scratch && n->resting ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
}

trocar_status rest_again(trocar_sim *sim, trocar_error *why) {
    resting_needle *list[MAX_NEEDLES];
    int count = list_attached(sim, list);
    atomic_store(&sim->link.resting, count);
    sim->resting.fading = left_of_release(sim);
    if (count == 0 && sim->resting.count == 0) return TROCAR_OK;
    for (int i = 0; i < count; i++) list[i]->id = ++sim->last_attached; /* another needle in this simulation may have had the saved id */
    trocar_status status = resting_set_attach(&sim->resting, count, list, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++)
        if (sim->needles[i].attached) show(sim, &sim->needles[i]);
    mark_stale(sim, NULL);
    return status;
}

static void hold_loads(const trocar_sim *sim, const insertion_state *state, bool left_only, tissue_loads *loads) {
    loads->count = 0;
    if (left_only) insertion_add_residual_loads(worker_model(sim), state, loads);
    else insertion_add_loads(worker_model(sim), state, loads);
}

/* Recomputes the resting needles' compliances for the current moduli and reattaches the needles. Their forces do not change. */
static trocar_status soften_resting(trocar_sim *sim, trocar_error *why) {
    resting_scratch *scratch = sim->resting_scratch;
    other_loads held;
    list_others(sim, BESIDE_RESTING, &held);
    trocar_status status = resting_set_change(&sim->resting, 0, NULL, &held, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        sim_needle *n = &sim->needles[i];
        if (!n->attached) continue;
        tick_input tick = {.model = worker_model(sim), .snapshot = link_answer_slot(&n->link), .dt = TICK};
        status = answer_fully(sim, i, &n->resting->anchor.request, why);
        if (status == TROCAR_OK) status = resting_soften(&tick, sim->inverse, scratch, n->resting, why);
        hold_loads(sim, &n->resting->anchor, true, &n->held);
    }
    trocar_error ignored;
    trocar_status attached = attach_all(sim, status == TROCAR_OK ? why : &ignored);
    return status == TROCAR_OK ? attached : status;
}

trocar_status rest_before_softening(trocar_sim *sim, double **displacement, trocar_error *why) {
    resting_needle *list[MAX_NEEDLES];
    int count = list_attached(sim, list);
    bool again = sim->elasticity.course.mixed == 0.0; /* the forces may have changed since the last change of moduli */
    other_loads held;
    *displacement = NULL;
    if (count == 0) return TROCAR_OK;
    for (int i = 0; i < count; i++) again = again || !list[i]->alone;
    trocar_status status = respond_to_loads(sim, false, why); /* before reattaching, the needles' forces must match the held needles' loads */
    if (status == TROCAR_OK && again) status = soften_resting(sim, why);
    list_others(sim, BESIDE_RESTING, &held);
    return status == TROCAR_OK ? resting_set_displacement(&sim->resting, &held, displacement, why) : status;
}

trocar_status rest_after_softening(trocar_sim *sim, const double *displacement, trocar_error *why) {
    resting_needle *list[MAX_NEEDLES];
    other_loads held;
    if (!displacement) return TROCAR_OK;
    trocar_status status = soften_resting(sim, why);
    list_others(sim, BESIDE_RESTING, &held);
    if (status == TROCAR_OK) status = resting_set_follow(&sim->resting, &held, displacement, why);
    int count = list_attached(sim, list);
    for (int i = 0; i < count && status != TROCAR_OK; i++) list[i]->alone = false; /* on failure, makes the next step reattach them */
    mark_stale(sim, NULL);
    return status;
}

/* True if another held needle is in the tissue. */
static bool is_felt_by_a_hand(const trocar_sim *sim, int index) {
    for (int i = 0; i < sim->needle_count; i++)
        if (i != index && !sim->needles[i].attached && sim->needles[i].held.count > 0) return true;
    return false;
}

static trocar_status lay_down(trocar_sim *sim, int index, unsigned seen, trocar_error *why) {
    sim_needle *n = &sim->needles[index];
    bool felt = is_felt_by_a_hand(sim, index);
    resting_set_before_release(&sim->resting);
    trocar_status status = make_room_to_rest(sim, n, why);
    insertion_state *state = malloc(sizeof *state);
    if (status == TROCAR_OK && !state) status = fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    if (status == TROCAR_OK) {
        const left_needle *left = link_left(&n->link);
        memcpy(state, &left->state, sizeof *state);
        status = release_base(sim, index, &left->others, state, why);
        if (status == TROCAR_OK) resting_bore(worker_model(sim), &left->state, n->resting);
    }
    if (status == TROCAR_OK) {
        hold_loads(sim, state, false, &n->held); /* before it is attached, this needle still counts as held, and the resting needles respond to it */
        status = respond_to_loads(sim, true, why);
    }
    if (status == TROCAR_OK) {
        hold_loads(sim, state, true, &n->held);
        n->resting->id = ++sim->last_attached;
        n->attached = true;
        status = attach_again(sim, why);
    }
    if (status == TROCAR_OK) {
        show(sim, n);
    } else {
        trocar_error ignored;
        n->attached = false;
        if (state) hold_loads(sim, &link_left(&n->link)->state, false, &n->held);
        respond_to_loads(sim, true, &ignored);
        attach_again(sim, &ignored);
    }
    resting_set_after_release(&sim->resting);
    for (int i = 0; i < sim->needle_count; i++) atomic_store_explicit(&sim->needles[i].link.since_release, felt ? 0 : RELEASE_TIME, memory_order_relaxed);
    resting_set_fade(&sim->resting, left_of_release(sim));
    free(state);
    link_complete(&n->link, seen, status == TROCAR_OK ? ON_RESTS : ON_STAYS); /* does nothing if the needle was reset meanwhile; it is then detached next */
    return status;
}

/* Replaces the needle's attachment with equivalent loads, so the equilibrium stays the same. */
static trocar_status detach(trocar_sim *sim, sim_needle *n, trocar_error *why) {
    trocar_status status = respond_to_loads(sim, true, why);
    resting_loads(n->resting, &n->held);
    insertion_add_residual_loads(worker_model(sim), &n->resting->anchor, &n->held);
    n->attached = false;
    trocar_status attached = attach_again(sim, why);
    return status == TROCAR_OK ? attached : status;
}

static trocar_status return_needle(trocar_sim *sim, int index, unsigned seen, trocar_error *why) {
    sim_needle *n = &sim->needles[index];
    link_request(&n->link, NULL); /* discards any request posted before the needle was left, so that it is not answered later */
    trocar_status status = detach(sim, n, why);
    const shown_needle *shown = find_shown(sim, n);
    if (status == TROCAR_OK) status = answer_fully(sim, index, &shown->state.request, why);
    if (status == TROCAR_OK) link_publish_answer(&n->link);
    link_publish_shown(&n->link);
    link_complete(&n->link, seen, ON_RELEASE);
    return status;
}

/* Removes a needle that was reset, so that its forces vanish. */
static trocar_status remove_needle(trocar_sim *sim, sim_needle *n, trocar_error *why) {
    trocar_status status = detach(sim, n, why);
    copy_loads(link_loads(&n->link, NULL), &n->held); /* may be nonzero: since the reset, the needle may have been inserted again */
    mark_stale(sim, NULL);
    return status == TROCAR_OK ? respond_to_loads(sim, true, why) : status;
}

trocar_status change_resting(trocar_sim *sim, resting_change *change, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    *change = (resting_change){.any = false};
    for (int i = 0; i < sim->needle_count; i++) {
        sim_needle *n = &sim->needles[i];
        unsigned seen = link_seen(&n->link);
        needle_duty duty = duty_in(phase_seen(seen), n->attached);
        if (duty == DUTY_NONE) continue;
        floating_mode before = flush_denormals();
        trocar_status one = TROCAR_OK;
        if (duty == DUTY_REMOVE) {
            one = remove_needle(sim, n, why);
            duty = one == TROCAR_OK ? duty_in(phase_seen(seen), n->attached) : DUTY_NONE;
        }
        if (duty == DUTY_LAY_DOWN) {
            one = lay_down(sim, i, seen, why);
            change->kept |= one == TROCAR_NUMERIC || one == TROCAR_BAD_INPUT;
        }
        if (duty == DUTY_RETURN) one = return_needle(sim, i, seen, why);
        restore_floating_mode(before);
        change->any = true;
        if (one != TROCAR_OK) status = one;
    }
    return status;
}
