/* Implements ticks and resets (trocar/sim.h), and leaving and taking needles (trocar/rest.h). */
#include "api/ticking.h"

#include <float.h>
#include <string.h>

#include "base/flush_denormals.h"
#include "insertion/step/hold.h"

trocar_status check_needle(const trocar_sim *sim, int needle, trocar_error *why) {
    if (has_needle(sim->model, needle)) return TROCAR_OK;
    if (!why) return TROCAR_BAD_INPUT;
    if (sim->needle_count == 1) return fail(why, TROCAR_BAD_INPUT, "needle %d: there is one, number 0; the scene's \"needles\" says how many", needle);
    return fail(why, TROCAR_BAD_INPUT, "needle %d: there are %d, numbers 0 to %d", needle, sim->needle_count, sim->needle_count - 1);
}

/* RT */
trocar_status check_pose(const trocar_pose *p, pose *out, trocar_error *why) {
    double norm = 0.0, sum = 0.0;
    for (int i = 0; i < 4; i++) norm += p->orientation[i] * p->orientation[i];
    for (int i = 0; i < 3; i++) sum += p->position[i];
    if (isfinite(sum) && fabs(sqrt(norm) - 1.0) <= 1e-3) {
        quat q = {p->orientation[0], p->orientation[1], p->orientation[2], p->orientation[3]};
        bool unit = fabs(norm - 1.0) <= 8 * DBL_EPSILON; /* already normalised; doing it again could change the last bit */
        *out = (pose){v3(p->position[0], p->position[1], p->position[2]), unit ? q : q_unit(q)};
        return TROCAR_OK;
    }
    if (!why) return TROCAR_BAD_INPUT;
    if (!isfinite(sum) || !isfinite(norm)) return fail(why, TROCAR_BAD_INPUT, "the pose is not finite");
    return fail(why, TROCAR_BAD_INPUT, "the orientation's length is %g: w x y z must be of unit length", sqrt(norm));
}

const shown_probe *shown_probe_of(const trocar_sim *sim) { return sim->probe ? probe_link_shown(&sim->link.probe) : NULL; }

const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp) {
    const sim_needle *n = &sim->needles[needle];
    const shown_needle *shown = link_shown(&n->link);
    if (stamp) *stamp = shown ? shown->stamp : n->stamp;
    return shown ? &shown->state : &n->state;
}

pose base_of_needle(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of_needle(sim, needle, NULL);
    pose base = sim->needles[needle].given;
    if (state != &sim->needles[needle].state) return state->needle.base;
    base.position = v3_add(base.position, state->base_shift);
    return base;
}

/* ---- needles that change hands ----------------------------------------------------------------------------------------------- */

void adopt_needle(trocar_sim *sim, sim_needle *n) {
    if (link_refuses(&n->link, ON_ADOPT)) return;
    memcpy(&n->state, &link_shown(&n->link)->state, sizeof n->state);
    n->stamp = next_stamp();
    n->softened = 0; /* makes the next tick call insertion_soften: the worker may have lagged behind the changing moduli */
    n->given = n->state.needle.base;
    n->loads.count = 0;
    insertion_add_loads(ticking_model(sim), &n->state, &n->loads);
    link_adopt(&n->link, &n->state, &n->loads);
}

/* Copies the tracks nearest the tip first, because there may not be room for all. */
void fill_message_of_left_needle(trocar_sim *sim, int needle) {
    static const double DISTANCES[] = {-1.0, 10e-3, 40e-3}; /* m, the first pass copies tracks up to 10 mm from the tip, the second up to 40 mm; a released
                                                               needle moves only a few millimetres */
    sim_needle *n = &sim->needles[needle];
    left_needle *slot = link_left_slot(&n->link);
    memcpy(&slot->state, &n->state, sizeof slot->state);
    slot->others.count = slot->others.point_count = 0;
    for (int ring = 0; ring < 2; ring++)
        for (int i = 0; i < sim->needle_count; i++)
            if (i != needle) tracks_copy_near(&sim->needles[i].state.tracks, n->state.tip.place.nominal, DISTANCES[ring], DISTANCES[ring + 1], &slot->others);
}

static trocar_status refuse(trocar_error *why, int needle, const char *reason) {
    if (why) fail(why, TROCAR_BAD_INPUT, "needle %d: %s", needle, reason);
    return TROCAR_BAD_INPUT;
}

/* Tells the worker that, until its next tick, the needle does not support the tissue against the probe. RT */
static void post_no_hold(const trocar_sim *sim, needle_link *link) {
    if (!sim->probe) return;
    link_hold_slot(link)->count = 0;
    link_publish_hold(link);
}

trocar_status trocar_sim_leave(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_status status = check_needle(sim, needle, error);
    if (status != TROCAR_OK) return status;
    sim_needle *n = &sim->needles[needle];
    adopt_needle(sim, n);
    const char *reason = link_refuses(&n->link, ON_LEAVE);
    if (reason) return refuse(error, needle, reason);
    if (n->state.tip.place.phase == TIP_FREE) return refuse(error, needle, "it is not in the tissue: insert it before leaving it");
    if (n->state.moving_on) return refuse(error, needle, "it is on its way to another shape: hold it still first");
    fill_message_of_left_needle(sim, needle);
    post_no_hold(sim, &n->link);
    link_leave(&n->link, &n->state);
    wake_worker(&sim->link);
    return TROCAR_OK;
}

trocar_status trocar_sim_take(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_status status = check_needle(sim, needle, error);
    if (status != TROCAR_OK) return status;
    sim_needle *n = &sim->needles[needle];
    const char *reason = link_refuses(&n->link, ON_TAKE);
    if (reason) return refuse(error, needle, reason);
    link_take(&n->link);
    wake_worker(&sim->link);
    return TROCAR_OK;
}

trocar_needle_state trocar_sim_needle_state(const trocar_sim *sim, int needle) {
    static const trocar_needle_state states[] = {[PHASE_HELD] = TROCAR_NEEDLE_HELD, [PHASE_LEAVING] = TROCAR_NEEDLE_LEAVING,
                                                 [PHASE_RESTING] = TROCAR_NEEDLE_RESTING, [PHASE_TAKING] = TROCAR_NEEDLE_TAKING,
                                                 [PHASE_TAKEN] = TROCAR_NEEDLE_HELD};
    return has_needle(sim->model, needle) ? states[link_phase(&sim->needles[needle].link)] : TROCAR_NEEDLE_HELD;
}

trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error) {
    pose at;
    trocar_status status = check_needle(sim, needle, error);
    if (status == TROCAR_OK) status = check_pose(base, &at, error);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    sim_needle *n = &sim->needles[needle];
    adopt_needle(sim, n);
    n->given = at;
    insertion_reset(ticking_model(sim), at, &n->state);
    seeds_keep(needle, &sim->seeds);
    n->stamp = next_stamp();
    n->loads.count = 0;
    post_no_hold(sim, &n->link);
    if (link_reset(&n->link, n->state.request.serial) || n->link.posted_loads.count > 0) { /* tell the worker, so that other needles stop feeling this one */
        link_post_loads(&n->link, &(tissue_loads){.count = 0});
        wake_worker(&sim->link);
    }
    restore_floating_mode(before);
    return TROCAR_OK;
}

/* ---- ticks --------------------------------------------------------------------------------------------------------------- */

static trocar_output output_of(const tick_output *wrench) {
    return (trocar_output){.force = {wrench->force.x, wrench->force.y, wrench->force.z},
                           .torque = {wrench->torque.x, wrench->torque.y, wrench->torque.z}, .depth = wrench->depth,
                           .contacts = wrench->contacts, .events = wrench->events, .membrane = wrench->membrane, .passes = wrench->passes,
                           .switches = wrench->switches};
}

/* True if the needle's forces have changed enough since the last post that other needles would notice. RT */
static bool loads_changed(const sim_needle *needle) {
    static const double NOTICEABLE = 1e-3; /* N */
    const tissue_loads *now = &needle->loads, *then = &needle->link.posted_loads;
    if (now->count != then->count) return true;
    for (int i = 0; i < now->count; i++)
        if (v3_norm(v3_sub(now->loads[i].force, then->loads[i].force)) > NOTICEABLE) return true;
    return false;
}

void post_hold(trocar_sim *sim, sim_needle *needle, const compliance_snapshot *snapshot) {
    if (!sim->probe || !atomic_load_explicit(&sim->link.probe.placed, memory_order_relaxed)) return;
    tick_input tick = {.model = ticking_model(sim), .snapshot = snapshot, .base = {needle->given, needle->base_compliance}};
    floating_mode before = flush_denormals();
    insertion_hold(&tick, &needle->state, sim->workspace, link_hold_slot(&needle->link));
    restore_floating_mode(before);
    link_publish_hold(&needle->link);
}

/* Posts the needle's forces to the worker, which passes them on to the other needles. If there is only one needle, the worker needs only its track. With
   resting needles or a probe, posts at most once per response_period. RT */
static void post_loads(trocar_sim *sim, sim_needle *needle, const compliance_snapshot *snapshot, double dt) {
    bool rest = atomic_load_explicit(&sim->link.resting, memory_order_relaxed) > 0 || atomic_load_explicit(&sim->link.probe.placed, memory_order_relaxed);
    const shown_probe *probe = shown_probe_of(sim);
    double period = response_period(probe ? probe->output.contacts : 0);
    bool fades = rest && atomic_load_explicit(&needle->link.since_release, memory_order_relaxed) < RELEASE_TIME + (int64_t)(1e9 * period);
    bool catches_up = probe && probe->output.stopped;
    bool alone = !rest && sim->needle_count == 1, same_track = needle->loads.count == needle->link.posted_loads.count;
    needle->since_loads += dt;
    if ((alone && same_track) || (rest && needle->since_loads < period) || !(fades || catches_up || loads_changed(needle))) return;
    post_hold(sim, needle, snapshot);
    link_post_loads(&needle->link, &needle->loads);
    needle->since_loads = 0.0;
    wake_worker(&sim->link);
}

/* True if the worker needs the needle's forces: other bodies feel them, or the needle's residual loads displace its track. RT */
static bool is_felt(const trocar_sim *sim, const sim_needle *needle) {
    return sim->needle_count > 1 || sim->probe || needle->state.memory.residual.count > 0;
}

/* Advances simulated time for a tick of this needle. Needles that tick in turn share a round, in which time advances by `dt` only once. RT */
static void advance_time(round_clock *rounds, int needle, double dt) {
    uint32_t bit = UINT32_C(1) << needle;
    if (rounds->ticked & bit) rounds->ticked = 0;
    if (rounds->ticked == 0) rounds->time += dt;
    rounds->ticked |= bit;
}

tick_input tick_of(const trocar_sim *sim, int index, const compliance_snapshot *snapshot, double dt) {
    const sim_needle *needle = &sim->needles[index];
    tick_input tick = {.model = ticking_model(sim), .snapshot = snapshot, .base = {needle->given, needle->base_compliance}, .dt = dt};
    for (int i = 0; i < sim->needle_count; i++)
        if (i != index) tick.others[tick.other_count++] = &sim->needles[i].state.tracks;
    return tick;
}

static void follow_moduli(trocar_sim *sim, const tick_input *tick, sim_needle *needle) {
    elasticity *e = &sim->elasticity;
    if (elasticity_left(e) > 0.0) wake_worker(&sim->link);
    bool complete = elasticity_follow(e, &sim->changing->ticking, sim->rounds.time);
    if (needle->softened != e->moves) insertion_soften(tick, &needle->state, sim->workspace);
    needle->softened = e->moves;
    if (!complete) return;
    model_release(e->from.model);
    e->from = moduli_of(model_share(e->to.model));
    elasticity_rest(e);
}

trocar_status run_tick(trocar_sim *sim, int index, const compliance_snapshot *snapshot, pose base, double dt, trocar_output *output) {
    tick_output wrench;
    sim_needle *needle = &sim->needles[index];
    const insertion_model *model = ticking_model(sim);
    floating_mode before = flush_denormals();
    needle->given = base;
    advance_time(&sim->rounds, index, dt);
    tick_input tick = tick_of(sim, index, snapshot, dt);
    if (sim->changing) {
        values_follow(&sim->changing->ticking, sim->rounds.time);
        follow_moduli(sim, &tick, needle);
    }
    atomic_store_explicit(&sim->link.probe.time, llround(1e9 * sim->rounds.time), memory_order_relaxed);
    atomic_fetch_add_explicit(&needle->link.since_release, llround(1e9 * dt), memory_order_relaxed);
    insertion_tick(&tick, &needle->state, sim->workspace, &wrench);
    bool finite = insertion_is_finite(&needle->state, &wrench);
    if (finite) {
        seeds_follow(&needle->state, index, &sim->seeds);
    } else {
        insertion_start_over(model, base, &needle->state, &wrench);
        seeds_keep(index, &sim->seeds);
    }
    needle->loads.count = 0;
    if (is_felt(sim, needle)) insertion_add_loads(model, &needle->state, &needle->loads);
    needle->stamp = next_stamp();
    restore_floating_mode(before);
    needle->link.answered = snapshot->serial;
    *output = output_of(&wrench);
    return finite ? TROCAR_OK : TROCAR_NUMERIC;
}

trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0) || !has_needle(sim->model, needle) || check_pose(base, &at, NULL) != TROCAR_OK) return TROCAR_BAD_INPUT;
    sim_needle *n = &sim->needles[needle];
    adopt_needle(sim, n);
    if (link_refuses(&n->link, ON_TICK)) return TROCAR_BAD_INPUT;
    const compliance_snapshot *snapshot = link_answer(&n->link, n->state.request.insertion);
    trocar_status status = run_tick(sim, needle, snapshot, at, dt, output);
    post_loads(sim, n, snapshot, dt);
    if (link_post_request(&n->link, &n->state.request, sim->clock ? sim->clock() : 0)) wake_worker(&sim->link);
    return status;
}

void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance) {
    if (has_needle(sim->model, needle)) sim->needles[needle].base_compliance = compliance;
}

int64_t trocar_sim_waiting(const trocar_sim *sim) {
    int64_t longest = 0;
    for (int i = 0; sim->clock && i < sim->needle_count; i++) {
        int64_t waiting = link_waiting(&sim->needles[i].link, sim->clock());
        if (waiting > longest) longest = waiting;
    }
    return longest;
}
