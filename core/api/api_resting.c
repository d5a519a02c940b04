/* trocar.h: needles that rest. See README.md, "Resting needles". */
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h"
#include "base/cache_line.h"
#include "base/flush_denormals.h"

enum { MOST_TICKS = 2000 };            /* until a needle that was let go of has come to rest: 2 s, in which what its shaft lags behind decays */

/* Wrench that its base may be left with, and how far its shaft may slide in a tick. */
typedef struct { double force, torque, slip; } rest_limits; /* N, N m, m */
static const rest_limits AT_REST = {1e-3, 1e-4, 1e-7}, RELAXING = {20e-3, 2e-3, 2e-6}; /* tissue that relaxes creeps on for seconds */

static const double LARGEST_STEP = 16.0; /* times that without sliding */
static const double TICK = 1e-3;       /* s */
static const double SHOWN = 1e-4, SHOWN_ALL = 1e-7; /* N, by which a force may differ from what is shown */
enum { SHOWN_AT_ONCE = 4 };            /* needles whose shape is found in one pass of the worker */
enum { SERIALS_APART = 1 << 20 };      /* keeps serials issued after a reset apart from the worker's */

/* ---- the ticking thread ------------------------------------------------------------------------------------------------- */

const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp) {
    needle_track *n = &sim->needles[needle];
    needle_phase phase = phase_of(n);
    const shown_needle *shown = phase == PHASE_HELD || phase == PHASE_LEAVING ? NULL : triple_buffer_read(&n->shown, NULL);
    if (stamp) *stamp = shown ? shown->stamp : n->stamp;
    return shown ? &shown->state : &n->state;
}

void adopt_needle(trocar_sim *sim, needle_track *n) {
    if (phase_of(n) != PHASE_TAKEN) return;
    const shown_needle *shown = triple_buffer_read(&n->shown, NULL);
    memcpy(&n->state, &shown->state, sizeof n->state);
    n->stamp = next_stamp();
    n->given = n->state.needle.base;
    n->loads.count = 0;
    insertion_add_loads(&sim->model->parts.insertion, &n->state, &n->loads);
    copy_loads(&n->loads, &n->posted_loads); /* the worker has them from the needle's rest */
    n->posted = n->answered = n->state.request.serial;
    change_phase(n, PHASE_HELD);
}

/* Those nearest to the tip first, should there be no room for all. */
void post_left(trocar_sim *sim, int needle) {
    static const double DISTANCES[] = {-1.0, 10e-3, 40e-3}; /* m; needles move by some millimetres while they are let go of */
    needle_track *n = &sim->needles[needle];
    left_needle *slot = triple_buffer_slot(&n->left);
    memcpy(&slot->state, &n->state, sizeof slot->state);
    slot->others.count = slot->others.point_count = 0;
    for (int ring = 0; ring < 2; ring++)
        for (int i = 0; i < sim->needle_count; i++)
            if (i != needle) tracks_copy_near(&sim->needles[i].state.tracks, n->state.tip.place.nominal, DISTANCES[ring], DISTANCES[ring + 1], &slot->others);
    triple_buffer_publish(&n->left);
}

static trocar_status refuse(report *why, int needle, const char *reason) {
    if (why) fail(why, TROCAR_BAD_INPUT, "needle %d: %s", needle, reason);
    return TROCAR_BAD_INPUT;
}

trocar_status trocar_sim_leave(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_status status = check_needle(sim, needle, error);
    if (status != TROCAR_OK) return status;
    needle_track *n = &sim->needles[needle];
    adopt_needle(sim, n);
    if (phase_of(n) != PHASE_HELD) return refuse(error, needle, "it rests already");
    if (n->state.tip.place.phase == TIP_FREE) return refuse(error, needle, "it is not in the tissue, where it could rest");
    if (n->state.moving_on) return refuse(error, needle, "it is on its way to another shape: hold it still first");
    post_left(sim, needle);
    n->state.request.serial += SERIALS_APART;
    n->state.next_id += SERIALS_APART;
    change_phase(n, PHASE_LEAVING);
    wake_worker(sim);
    return TROCAR_OK;
}

trocar_status trocar_sim_take(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_status status = check_needle(sim, needle, error);
    if (status != TROCAR_OK) return status;
    needle_track *n = &sim->needles[needle];
    needle_phase phase = phase_of(n);
    if (phase != PHASE_RESTING) return refuse(error, needle, phase == PHASE_LEAVING ? "it has not come to rest yet" : "it does not rest");
    change_phase(n, PHASE_TAKING);
    wake_worker(sim);
    return TROCAR_OK;
}

trocar_needle_state trocar_sim_needle_state(const trocar_sim *sim, int needle) {
    static const trocar_needle_state states[] = {[PHASE_HELD] = TROCAR_NEEDLE_HELD, [PHASE_LEAVING] = TROCAR_NEEDLE_LEAVING,
                                                 [PHASE_RESTING] = TROCAR_NEEDLE_RESTING, [PHASE_TAKING] = TROCAR_NEEDLE_TAKING,
                                                 [PHASE_TAKEN] = TROCAR_NEEDLE_HELD};
    return has_needle(sim->model, needle) ? states[phase_of(&sim->needles[needle])] : TROCAR_NEEDLE_HELD;
}

/* ---- the worker: loads ---------------------------------------------------------------------------------------------------- */

void list_others(const trocar_sim *sim, int needle, other_loads *others) {
    *others = (other_loads){.beneath = sim->resting.inverse, .attached = needle != BESIDE_RESTING && sim->resting.count > 0 ? sim->resting.load : NULL};
    if (needle != BESIDE_PROBE && sim->probe && sim->probe->now.count > 0) others->pressed = needle >= 0 ? &sim->probe->unloaded : &sim->probe->now;
    for (int i = 0; i < sim->needle_count; i++)
        if (i != needle && sim->needles[i].held.count > 0) others->of[others->count++] = &sim->needles[i].held;
}

void mark_stale(trocar_sim *sim, const needle_track *except) {
    for (int i = 0; i < sim->needle_count; i++)
        if (&sim->needles[i] != except) atomic_store_explicit(&sim->needles[i].stale, true, memory_order_release);
}

/* ---- the worker: letting go ----------------------------------------------------------------------------------------------- */

static bool is_at_rest(const insertion_model *model, const insertion_state *state, const tick_output *wrench) {
    const rest_limits *limits = model->creep.count > 0 ? &RELAXING : &AT_REST;
    vec3 axis = q_axis(state->needle.base.orientation), across = v3_axpy(-v3_dot(wrench->torque, axis), axis, wrench->torque);
    double slip = fmax(fabs(state->tip.solved.slip), fabs(state->tip.shaft.slip));
    for (int k = 0; contact_is_active(state, k); k++) slip = fmax(slip, fabs(state->contacts[state->refined.order[k]].shaft.slip));
    return v3_norm(wrench->force) < limits->force && v3_norm(across) < limits->torque && slip < limits->slip;
}

/* The hand lets go: the base moves until its wrench has vanished, and with it the needle. Linearised there, it is ready to be attached. */
static trocar_status let_go(trocar_sim *sim, int index, const track_list *others, insertion_state *state, report *why) {
    needle_track *n = &sim->needles[index];
    resting_scratch *scratch = sim->resting_scratch;
    const compliance_snapshot *snapshot = triple_buffer_slot(&n->snapshots); /* not published: nobody ticks this needle now */
    tick_output wrench;
    tick_input tick = {.model = &sim->model->parts.insertion, .snapshot = snapshot, .dt = TICK, .base = {.pose = state->needle.base}, .others = {others}, .other_count = 1};
    state->base_shift = v3(0, 0, 0);
    trocar_status status = answer_fully(sim, index, &state->request, why);
    double size = 1.0; /* of the steps: they get larger while the wrench hardly falls, as the shaft slides */
    vec3 before = v3(0, 0, 0);
    for (int i = 0; i < MOST_TICKS && status == TROCAR_OK; i++) {
        base_motion step;
        insertion_tick(&tick, state, &scratch->workspace, &wrench);
        if (state->moving_on || !insertion_is_finite(state, &wrench)) return fail(why, TROCAR_NUMERIC, "needle %d finds no equilibrium when it is let go", index);
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
    return fail(why, TROCAR_NUMERIC, "needle %d does not come to rest when it is let go: %.2g N are left at its base", index, v3_norm(wrench.force));
}

/* ---- the worker: what rests -------------------------------------------------------------------------------------------------- */

static int list_attached(const trocar_sim *sim, resting_needle *list[MAX_NEEDLES]) {
    int count = 0;
    for (int i = 0; i < sim->needle_count; i++)
        if (sim->needles[i].attached) list[count++] = sim->needles[i].resting;
    return count;
}

/* Attaches what rests, after something has come or gone. */
static trocar_status attach_again(trocar_sim *sim, report *why) {
    resting_needle *list[MAX_NEEDLES];
    other_loads held;
    int count = list_attached(sim, list);
    atomic_store(&sim->resting_count, count);
    list_others(sim, BESIDE_RESTING, &held);
    mark_stale(sim, NULL);
    trocar_status status = resting_set_change(&sim->resting, count, list, &held, why);
    return status == TROCAR_OK ? press_probe(sim, why) : status;
}

/* The needle as it is, in the slot that is published next. */
static const shown_needle *find_shown(trocar_sim *sim, needle_track *n) {
    shown_needle *slot = triple_buffer_slot(&n->shown);
    resting_show(&sim->model->parts.insertion, n->resting, &sim->resting_scratch->workspace.response.tangent, &slot->state);
    slot->stamp = next_stamp();
    memcpy(n->shown_force, n->resting->force, sizeof n->shown_force);
    return slot;
}

static void show(trocar_sim *sim, needle_track *n) {
    find_shown(sim, n);
    triple_buffer_publish(&n->shown);
}

/* Those whose forces differ by more than this from what is shown, at most so many. */
static void show_changed(trocar_sim *sim, double difference, int most) {
    for (int i = 0; i < sim->needle_count && most > 0; i++) {
        needle_track *n = &sim->needles[sim->next_shown = (sim->next_shown + 1) % sim->needle_count];
        bool changed = false;
        for (int u = 0; n->attached && u < n->resting->unknown_count && !changed; u++) changed = fabs(n->resting->force[u] - n->shown_force[u]) > difference;
        if (changed) show(sim, n), most--;
    }
}

bool slip_some(trocar_sim *sim, bool all) {
    uint64_t before = sim->resting.shifts;
    if (sim->resting.count == 0) return false;
    bool more = resting_set_slip(&sim->resting, &sim->model->parts.insertion, all ? INT_MAX : 1);
    if (sim->resting.shifts != before) mark_stale(sim, NULL);
    if (!more) show_changed(sim, all ? SHOWN_ALL : SHOWN, all ? MAX_NEEDLES : SHOWN_AT_ONCE);
    return more;
}

/* Part of what the last release has changed that the others do not feel yet, by the clock of the needle that has been ticked most since then. */
static double left_of_release(const trocar_sim *sim) {
    int64_t most = 0;
    for (int i = 0; i < sim->needle_count; i++) {
        int64_t since = atomic_load_explicit(&sim->needles[i].since_release, memory_order_relaxed);
        if (since > most) most = since;
    }
    return most < RELEASE_TIME ? 1.0 - (double)most / (double)RELEASE_TIME : 0.0;
}

trocar_status respond_to_loads(trocar_sim *sim, bool all, report *why) {
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

trocar_status make_room_to_rest(trocar_sim *sim, needle_track *n, report *why) {
    if (!sim->resting_scratch) sim->resting_scratch = allocate_on_cache_lines(sizeof *sim->resting_scratch);
    if (!n->resting) n->resting = calloc(1, sizeof *n->resting);
    return sim->resting_scratch && n->resting ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
}

trocar_status rest_again(trocar_sim *sim, report *why) {
    resting_needle *list[MAX_NEEDLES];
    int count = list_attached(sim, list);
    atomic_store(&sim->resting_count, count);
    sim->resting.fading = left_of_release(sim);
    if (count == 0 && sim->resting.count == 0) return TROCAR_OK;
    for (int i = 0; i < count; i++) list[i]->id = ++sim->last_attached; /* this simulation may know another one under its number */
    trocar_status status = resting_set_attach(&sim->resting, count, list, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++)
        if (sim->needles[i].attached) show(sim, &sim->needles[i]);
    mark_stale(sim, NULL);
    return status;
}

static void hold_loads(const trocar_sim *sim, const insertion_state *state, bool left_only, tissue_loads *loads) {
    loads->count = 0;
    if (left_only) insertion_add_residual_loads(&sim->model->parts.insertion, state, loads);
    else insertion_add_loads(&sim->model->parts.insertion, state, loads);
}

/* Is another needle that is held in the tissue? */
static bool is_felt_by_a_hand(const trocar_sim *sim, int index) {
    for (int i = 0; i < sim->needle_count; i++)
        if (i != index && !sim->needles[i].attached && sim->needles[i].held.count > 0) return true;
    return false;
}

static trocar_status leave_needle(trocar_sim *sim, int index, unsigned seen, report *why) {
    needle_track *n = &sim->needles[index];
    bool felt = is_felt_by_a_hand(sim, index);
    resting_set_before_release(&sim->resting);
    trocar_status status = make_room_to_rest(sim, n, why);
    insertion_state *state = malloc(sizeof *state);
    if (status == TROCAR_OK && !state) status = fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    if (status == TROCAR_OK) {
        const left_needle *left = triple_buffer_read(&n->left, NULL);
        memcpy(state, &left->state, sizeof *state);
        status = let_go(sim, index, &left->others, state, why);
        if (status == TROCAR_OK) resting_bore(&sim->model->parts.insertion, &left->state, n->resting);
    }
    if (status == TROCAR_OK) {
        hold_loads(sim, state, false, &n->held); /* the others as it is now, before it becomes one of them */
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
        report ignored;
        n->attached = false;
        if (state) hold_loads(sim, &((const left_needle *)triple_buffer_read(&n->left, NULL))->state, false, &n->held);
        respond_to_loads(sim, true, &ignored);
        attach_again(sim, &ignored);
    }
    resting_set_after_release(&sim->resting);
    for (int i = 0; i < sim->needle_count; i++) atomic_store_explicit(&sim->needles[i].since_release, felt ? 0 : RELEASE_TIME, memory_order_relaxed);
    resting_set_fade(&sim->resting, left_of_release(sim));
    free(state);
    complete_phase(n, seen, status == TROCAR_OK ? PHASE_RESTING : PHASE_HELD); /* one that has been reset meanwhile is detached next */
    return status;
}

/* Goes on with what the needle does to the tissue as loads that are not attached to it, which changes nothing. */
static trocar_status detach(trocar_sim *sim, needle_track *n, report *why) {
    trocar_status status = respond_to_loads(sim, true, why);
    resting_loads(n->resting, &n->held);
    insertion_add_residual_loads(&sim->model->parts.insertion, &n->resting->anchor, &n->held);
    n->attached = false;
    trocar_status attached = attach_again(sim, why);
    return status == TROCAR_OK ? attached : status;
}

static trocar_status take_needle(trocar_sim *sim, int index, unsigned seen, report *why) {
    needle_track *n = &sim->needles[index];
    triple_buffer_read(&n->requests, NULL); /* one from before it was left would be answered after this */
    trocar_status status = detach(sim, n, why);
    const shown_needle *shown = find_shown(sim, n);
    if (status == TROCAR_OK) status = answer_fully(sim, index, &shown->state.request, why);
    if (status == TROCAR_OK) triple_buffer_publish(&n->snapshots);
    triple_buffer_publish(&n->shown);
    complete_phase(n, seen, PHASE_TAKEN);
    return status;
}

/* It has been reset: its forces vanish. */
static trocar_status drop_needle(trocar_sim *sim, needle_track *n, report *why) {
    trocar_status status = detach(sim, n, why);
    copy_loads(triple_buffer_read(&n->loads_out, NULL), &n->held); /* it may have been pushed in again */
    mark_stale(sim, NULL);
    return status == TROCAR_OK ? respond_to_loads(sim, true, why) : status;
}

trocar_status change_resting(trocar_sim *sim, resting_change *change, report *why) {
    trocar_status status = TROCAR_OK;
    *change = (resting_change){.any = false};
    for (int i = 0; i < sim->needle_count; i++) {
        needle_track *n = &sim->needles[i];
        unsigned seen = atomic_load_explicit(&n->phase, memory_order_acquire);
        needle_phase phase = (needle_phase)(seen % PHASES);
        bool dropped = n->attached && (phase == PHASE_HELD || phase == PHASE_LEAVING);
        if (!dropped && phase != PHASE_LEAVING && phase != PHASE_TAKING) continue;
        floating_mode before = flush_denormals();
        trocar_status one = dropped ? drop_needle(sim, n, why) : TROCAR_OK;
        if (one == TROCAR_OK && phase == PHASE_LEAVING) {
            one = leave_needle(sim, i, seen, why);
            change->kept |= one == TROCAR_NUMERIC || one == TROCAR_BAD_INPUT;
        }
        if (one == TROCAR_OK && phase == PHASE_TAKING) one = take_needle(sim, i, seen, why);
        restore_floating_mode(before);
        change->any = true;
        if (one != TROCAR_OK) status = one;
    }
    return status;
}
