/* trocar.h: simulations. */
#include <errno.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "api/api.h"
#include "base/cache_line.h"
#include "base/flush_denormals.h"
#include "remesh/free_displacement.h"

_Static_assert(TROCAR_MAX_CONTACTS == (int)MAX_CONTACTS && TROCAR_MAX_JOINTS == NEEDLE_MAX_SEGMENTS + 1 && TROCAR_MAX_NEEDLES == (int)MAX_NEEDLES,
               "limits differ from trocar.h");
_Static_assert(TROCAR_MAX_GUIDES == (int)MAX_GUIDES && TROCAR_MAX_POINTS == (int)MAX_POINTS, "limits differ from trocar.h");
_Static_assert(TROCAR_CONTACT_TISSUE == (int)POINT_TISSUE && TROCAR_CONTACT_TIP == (int)POINT_TIP && TROCAR_CONTACT_GUIDE == (int)POINT_GUIDE, "contact kinds differ from trocar.h");
_Static_assert(TROCAR_EVENT_TOUCHED == (int)EVENT_TOUCHED && TROCAR_EVENT_TRACK_DROPPED == (int)EVENT_TRACK_DROPPED && TROCAR_EVENT_INEXACT == (int)EVENT_INEXACT, "event bits differ from trocar.h");
_Static_assert(TROCAR_MAX_TRACKS == (int)MAX_TRACKS && TROCAR_MAX_TRACK_POINTS == (int)MAX_TRACK_POINTS && NO_MEMBRANE == -1, "limits differ from trocar.h");
_Static_assert(TROCAR_STAGES == (int)INSERTION_STAGES && TROCAR_STAGE_WRENCH == (int)INSERTION_WRENCH, "stages differ from trocar.h");

/* s, between two responses of what rests to the forces of held needles; longer while a probe presses so many nodes, which takes the worker longer. RT */
static double response_period(int pressed) { return pressed > 0 ? 0.01 : 0.004; }

enum { MOST_ANSWERS = 4 };             /* to requests, one after another, before what rests gets its turn */

/* ---- creation ------------------------------------------------------------------------------------------------------------ */

static trocar_status create_needle(const trocar_sim *sim, needle_track *needle, report *why) {
    trocar_status status = triple_buffer_create(&needle->requests, sizeof(posted_request), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&needle->snapshots, sizeof(compliance_snapshot), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&needle->loads_out, sizeof(tissue_loads), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&needle->left, sizeof(left_needle), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&needle->shown, sizeof(shown_needle), why);
    if (status != TROCAR_OK) return status;
    return remesher_create(sim->inverse, sim->model->parts.config.remeshing, &needle->remesher, why);
}

static trocar_status create_inverse(trocar_sim *sim, report *why) {
    simulation *parts = &sim->model->parts;
    sim->inverse = parts->inverse;
    return inverse_create_attached(parts->inverse, &sim->resting.inverse, why);
}

static trocar_status allocate(trocar_sim *sim, report *why) {
    size_t needles = (size_t)sim->needle_count * sizeof *sim->needles;
    sim->needles = allocate_on_cache_lines(needles); /* touched, so that no page fault comes later */
    sim->workspace = allocate_on_cache_lines(sizeof *sim->workspace);
    sim->work_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (!sim->needles || !sim->workspace) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    if (sim->work_wake < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    trocar_status status = create_inverse(sim, why);
    if (sim->resting.inverse) sim->inverse = sim->resting.inverse;
    if (status == TROCAR_OK) status = create_probe(sim, why);
    if (status == TROCAR_OK && sim->needle_count > 1)
        status = needle_pairs_create(&sim->model->parts.tissue, sim->model->parts.needle.radius, &sim->pairs, why);
    sim->resting.pairs = sim->pairs;
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) status = create_needle(sim, &sim->needles[i], why);
    return status;
}

trocar_status trocar_sim_create(trocar_model *model, trocar_sim **created, trocar_error *error) {
    static const trocar_pose at_origin = {{0, 0, 0}, {1, 0, 0, 0}};
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "this model is its mesh alone: create it without mesh_only");
    trocar_sim *sim = calloc(1, sizeof *sim);
    if (!sim) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    sim->model = model_share(model);
    sim->needle_count = model->parts.config.needle_count;
    sim->work_wake = -1;
    trocar_status status = allocate(sim, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        sim->needles[i].since_release = RELEASE_TIME;
        status = trocar_sim_reset(sim, i, &at_origin, why);
        sim->needles[i].state.tracks = (track_list){.count = 0}; /* nobody has put it there: it has cut nothing */
    }
    if (status == TROCAR_OK) *created = sim;
    else trocar_sim_free(sim);
    return status;
}

void trocar_sim_free(trocar_sim *sim) {
    if (!sim) return;
    for (int i = 0; sim->needles && i < sim->needle_count; i++) {
        remesher_free(sim->needles[i].remesher);
        triple_buffer_free(&sim->needles[i].requests);
        triple_buffer_free(&sim->needles[i].snapshots);
        triple_buffer_free(&sim->needles[i].loads_out);
        triple_buffer_free(&sim->needles[i].left);
        triple_buffer_free(&sim->needles[i].shown);
        free(sim->needles[i].resting);
    }
    probe_free(sim->probe);
    triple_buffer_free(&sim->probe_poses);
    triple_buffer_free(&sim->probe_shown);
    resting_set_free(&sim->resting);
    needle_pairs_free(sim->pairs);
    inverse_free(sim->resting.inverse);
    free(sim->resting_scratch);
    if (sim->work_wake >= 0) close(sim->work_wake);
    free(sim->needles);
    free(sim->workspace);
    free(sim->field_scratch);
    trocar_model_free(sim->model);
    free(sim);
}

uint64_t next_stamp(void) {
    static atomic_uint_fast64_t last;
    return atomic_fetch_add_explicit(&last, 1, memory_order_relaxed) + 1;
}

/* ---- ticks --------------------------------------------------------------------------------------------------------------- */

trocar_status check_needle(const trocar_sim *sim, int needle, report *why) {
    if (has_needle(sim->model, needle)) return TROCAR_OK;
    if (!why) return TROCAR_BAD_INPUT;
    if (sim->needle_count == 1) return fail(why, TROCAR_BAD_INPUT, "needle %d: there is one, number 0; the scene's \"needles\" says how many", needle);
    return fail(why, TROCAR_BAD_INPUT, "needle %d: there are %d, numbers 0 to %d", needle, sim->needle_count, sim->needle_count - 1);
}

/* RT */
trocar_status check_pose(const trocar_pose *p, pose *out, report *why) {
    double norm = 0.0, sum = 0.0;
    for (int i = 0; i < 4; i++) norm += p->orientation[i] * p->orientation[i];
    for (int i = 0; i < 3; i++) sum += p->position[i];
    if (isfinite(sum) && fabs(sqrt(norm) - 1.0) <= 1e-3) {
        quat q = {p->orientation[0], p->orientation[1], p->orientation[2], p->orientation[3]};
        bool unit = fabs(norm - 1.0) <= 8 * DBL_EPSILON; /* as it comes out of q_unit: normalising it again could change its last bit */
        *out = (pose){v3(p->position[0], p->position[1], p->position[2]), unit ? q : q_unit(q)};
        return TROCAR_OK;
    }
    if (!why) return TROCAR_BAD_INPUT;
    if (!isfinite(sum) || !isfinite(norm)) return fail(why, TROCAR_BAD_INPUT, "the pose is not finite");
    return fail(why, TROCAR_BAD_INPUT, "the orientation's length is %g: w x y z must be of unit length", sqrt(norm));
}

trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error) {
    pose at;
    trocar_status status = check_needle(sim, needle, error);
    if (status == TROCAR_OK) status = check_pose(base, &at, error);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    needle_track *n = &sim->needles[needle];
    if (phase_of(n) == PHASE_TAKEN) adopt_needle(sim, n);
    n->given = at;
    insertion_reset(&sim->model->parts.insertion, at, &n->state);
    seeds_keep(needle, &sim->seeds);
    n->stamp = next_stamp();
    n->loads.count = 0;
    bool rested = phase_of(n) != PHASE_HELD;
    if (rested) { /* the worker takes it out of the tissue */
        n->posted = n->answered = n->state.request.serial - 1;
        change_phase(n, PHASE_HELD);
    }
    if (rested || n->posted_loads.count > 0) { /* the others no longer feel it: said after it is held, as what a resting needle posts is not read */
        tissue_loads *slot = triple_buffer_slot(&n->loads_out);
        slot->count = n->posted_loads.count = 0;
        triple_buffer_publish(&n->loads_out);
        wake_worker(sim);
    }
    restore_floating_mode(before);
    return TROCAR_OK;
}

static void answer(const tick_output *wrench, trocar_output *output) {
    *output = (trocar_output){.force = {wrench->force.x, wrench->force.y, wrench->force.z},
                              .torque = {wrench->torque.x, wrench->torque.y, wrench->torque.z}, .depth = wrench->depth,
                              .contacts = wrench->contacts, .events = wrench->events, .membrane = wrench->membrane, .passes = wrench->passes,
                              .switches = wrench->switches};
}

/* Have the needle's forces changed enough for the others to feel it? RT */
static bool loads_changed(const needle_track *needle) {
    static const double NOTICEABLE = 1e-3; /* N */
    const tissue_loads *now = &needle->loads, *then = &needle->posted_loads;
    if (now->count != then->count) return true;
    for (int i = 0; i < now->count; i++)
        if (v3_norm(v3_sub(now->loads[i].force, then->loads[i].force)) > NOTICEABLE) return true;
    return false;
}

void wake_worker(const trocar_sim *sim) {
    uint64_t one = 1;
    ssize_t written = write(sim->work_wake, &one, sizeof one); /* fails only if the counter is full: the worker is awake anyway */
    (void)written;
}

/* Hands the worker what the tick wants to know next, if that has changed, or if what it knows no longer holds. RT */
static void post_request(trocar_sim *sim, needle_track *needle) {
    uint64_t serial = needle->state.request.serial;
    bool stale = atomic_load_explicit(&needle->stale, memory_order_relaxed) && atomic_exchange_explicit(&needle->stale, false, memory_order_acquire);
    if (serial == needle->posted && !stale) return;
    posted_request *slot = triple_buffer_slot(&needle->requests);
    int64_t asked = slot->asked = sim->clock ? sim->clock() : 0;
    slot->request = needle->state.request;
    triple_buffer_publish(&needle->requests);
    if (serial - needle->posted > REQUESTS_REMEMBERED) needle->posted = serial - REQUESTS_REMEMBERED; /* after a restore */
    while (needle->posted < serial) needle->asked[++needle->posted % REQUESTS_REMEMBERED] = asked;
    wake_worker(sim);
}

/* Tells the worker the needle's forces, for the others. Needles that rest and the probe respond at a pace of their own. RT */
static void post_loads(trocar_sim *sim, needle_track *needle, double dt) {
    bool rest = atomic_load_explicit(&sim->resting_count, memory_order_relaxed) > 0 || atomic_load_explicit(&sim->probe_placed, memory_order_relaxed);
    const shown_probe *probe = probe_shown(sim);
    double period = response_period(probe ? probe->told.contacts : 0);
    bool fades = rest && atomic_load_explicit(&needle->since_release, memory_order_relaxed) < RELEASE_TIME + (int64_t)(1e9 * period);
    needle->since_loads += dt;
    if ((!rest && sim->needle_count == 1) || (rest && needle->since_loads < period) || !(fades || loads_changed(needle))) return;
    copy_loads(&needle->loads, triple_buffer_slot(&needle->loads_out));
    triple_buffer_publish(&needle->loads_out);
    copy_loads(&needle->loads, &needle->posted_loads);
    needle->since_loads = 0.0;
    wake_worker(sim);
}

/* Does anything but the needle itself feel its forces? RT */
static bool is_felt(const trocar_sim *sim) { return sim->needle_count > 1 || sim->probe; }

/* One tick with what `snapshot` knows of the tissue. A number that is not finite would stay in the state: then the insertion starts
   over, and the answer is NUMERIC. RT */
static trocar_status run_tick(trocar_sim *sim, int index, const compliance_snapshot *snapshot, pose base, double dt, trocar_output *output) {
    tick_output wrench;
    needle_track *needle = &sim->needles[index];
    const insertion_model *model = &sim->model->parts.insertion;
    floating_mode before = flush_denormals();
    needle->given = base;
    atomic_fetch_add_explicit(&needle->since_release, llround(1e9 * dt), memory_order_relaxed);
    tick_context tick = {.model = model, .state = &needle->state, .snapshot = snapshot, .scratch = sim->workspace,
                         .base = {base, needle->base_compliance}, .dt = dt, .output = &wrench};
    for (int i = 0; i < sim->needle_count; i++)
        if (i != index) tick.others[tick.other_count++] = &sim->needles[i].state.tracks;
    insertion_tick(&tick);
    bool finite = insertion_is_finite(&needle->state, &wrench);
    if (finite) {
        seeds_follow(&needle->state, index, &sim->seeds);
    } else {
        insertion_start_over(model, base, &needle->state, &wrench);
        seeds_keep(index, &sim->seeds);
    }
    needle->loads.count = 0;
    if (is_felt(sim)) insertion_add_loads(model, &needle->state, &needle->loads);
    needle->stamp = next_stamp();
    restore_floating_mode(before);
    needle->answered = snapshot->serial;
    answer(&wrench, output);
    return finite ? TROCAR_OK : TROCAR_NUMERIC;
}

trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0) || !has_needle(sim->model, needle) || check_pose(base, &at, NULL) != TROCAR_OK) return TROCAR_BAD_INPUT;
    needle_track *n = &sim->needles[needle];
    adopt_needle(sim, n);
    if (phase_of(n) != PHASE_HELD) return TROCAR_BAD_INPUT;
    trocar_status status = run_tick(sim, needle, triple_buffer_read(&n->snapshots, NULL), at, dt, output);
    post_loads(sim, n, dt);
    post_request(sim, n);
    return status;
}

void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance) {
    if (has_needle(sim->model, needle)) sim->needles[needle].base_compliance = compliance;
}

int64_t trocar_sim_waiting(const trocar_sim *sim) {
    int64_t longest = 0;
    for (int i = 0; sim->clock && i < sim->needle_count; i++) {
        const needle_track *n = &sim->needles[i];
        if (n->answered >= n->posted || phase_of(n) != PHASE_HELD) continue;
        uint64_t oldest = n->posted - n->answered < REQUESTS_REMEMBERED ? n->answered + 1 : n->posted + 1; /* or the oldest remembered */
        int64_t waiting = sim->clock() - n->asked[oldest % REQUESTS_REMEMBERED];
        if (waiting > longest) longest = waiting;
    }
    return longest;
}

static const double AHEAD = 10e-3; /* m, of which the tip goes on before there is a newer answer */

/* The track of a needle, or of one in the air that which it would cut. */
static void lay_steps(const trocar_sim *sim, int index, const remesh_request *request, shaft_steps *steps) {
    const mesh *m = &sim->model->parts.mesh;
    shaft_steps_lay(m, &sim->needles[index].held, AHEAD, steps);
    if (steps->count > 0 || request->piece_count == 0) return;
    const line_in_tet *in = &request->pieces[0];
    tissue_loads track = {.count = 1, .loads = {{.shaft = {0.0, AHEAD, 0.0, in->point, in->direction, *in}}}};
    shaft_steps_lay(m, &track, 0.0, steps);
}

/* What the others add to that between the elements' nodes. */
static trocar_status find_unresolved(const trocar_sim *sim, int index, const remesh_request *request, const other_loads *others, unresolved_shift *shift, report *why) {
    shaft_steps steps;
    memset(shift, 0, sizeof *shift);
    if (!sim->pairs) return TROCAR_OK;
    lay_steps(sim, index, request, &steps);
    *shift = (unresolved_shift){.start = steps.start, .step = steps.step, .count = steps.count};
    trocar_status status = TROCAR_OK;
    for (int n = 0; n < others->count && status == TROCAR_OK; n++) status = needle_pairs_shift(sim->pairs, &steps, others->of[n], shift, why);
    if (status == TROCAR_OK) status = resting_set_shift(&sim->resting, phase_of(&sim->needles[index]) == PHASE_HELD, &steps, shift, why);
    for (int k = 0; k < steps.count; k++) shift->sum[k + 1] = v3_add(shift->sum[k + 1], shift->sum[k]);
    return status;
}

/* Fills u_free of the worker's slot: found for the first answer to a request, and the same for those that know more. Worker's side. */
static trocar_status fill_free(trocar_sim *sim, int index, const remesh_request *request, bool first, report *why) {
    needle_track *needle = &sim->needles[index];
    compliance_snapshot *snapshot = triple_buffer_slot(&needle->snapshots);
    other_loads others;
    if (!first) {
        snapshot->loaded = needle->loaded;
        memcpy(snapshot->u_free, needle->u_free, sizeof snapshot->u_free);
        snapshot->unresolved = needle->unresolved;
        return TROCAR_OK;
    }
    list_others(sim, index, &others);
    trocar_status status = free_displacement_find(sim->inverse, request, &others, snapshot, why);
    needle->loaded = snapshot->loaded;
    if (status == TROCAR_OK) status = find_unresolved(sim, index, request, &others, &snapshot->unresolved, why);
    memcpy(needle->u_free, snapshot->u_free, sizeof needle->u_free);
    needle->unresolved = snapshot->unresolved;
    needle->served_shifts = attached_shifts(sim);
    return status;
}

/* Rows of an inverse that has changed are no longer right. Worker's side. */
static trocar_status start_anew_if_changed(trocar_sim *sim, needle_track *needle, report *why) {
    if (needle->served_changes == attached_changes(sim)) return TROCAR_OK;
    needle->served_changes = attached_changes(sim);
    return remesher_forget(needle->remesher, why);
}

trocar_status answer_fully(trocar_sim *sim, int index, const remesh_request *request, report *why) {
    needle_track *needle = &sim->needles[index];
    trocar_status status = start_anew_if_changed(sim, needle, why);
    if (status == TROCAR_OK) status = remesher_answer(needle->remesher, request, triple_buffer_slot(&needle->snapshots), why);
    return status == TROCAR_OK ? fill_free(sim, index, request, true, why) : status;
}

static trocar_status answer_and_publish(trocar_sim *sim, int index, report *why) {
    needle_track *needle = &sim->needles[index];
    trocar_status status = answer_fully(sim, index, &needle->state.request, why);
    if (status == TROCAR_OK) triple_buffer_publish(&needle->snapshots);
    return status;
}

/* Lockstep: what others and what rests do to the tissue is known at once. */
static trocar_status catch_up(trocar_sim *sim, int index, report *why) {
    resting_change change;
    for (int i = 0; i < sim->needle_count; i++)
        if (phase_of(&sim->needles[i]) == PHASE_HELD && !sim->needles[i].attached) copy_loads(&sim->needles[i].loads, &sim->needles[i].held);
    bool moved = take_probe_pose(sim);
    trocar_status status = change_resting(sim, &change, why);
    if (status == TROCAR_OK && moved) status = press_probe(sim, why);
    needle_track *needle = &sim->needles[index];
    adopt_needle(sim, needle);
    if (status != TROCAR_OK) return status;
    if (phase_of(needle) != PHASE_HELD) return fail(why, TROCAR_BAD_INPUT, "needle %d rests: take it first", index);
    bool outdated = needle->served_changes != attached_changes(sim) || (moved && needle->served_shifts != attached_shifts(sim));
    return outdated ? answer_and_publish(sim, index, why) : TROCAR_OK;
}

/* Lockstep: what rests and the probe respond to this tick. */
static trocar_status respond(trocar_sim *sim, needle_track *needle, double dt, report *why) {
    copy_loads(&needle->loads, &needle->held);
    sim->since_response += dt;
    double period = response_period(sim->probe ? sim->probe->state.count : 0);
    if ((sim->resting.count == 0 && !sim->probe) || sim->since_response < period - 1e-9) return TROCAR_OK;
    sim->since_response = 0.0;
    trocar_status status = press_probe(sim, why);
    return status != TROCAR_OK ? status : respond_to_loads(sim, true, why);
}

trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    pose at;
    if (!(dt > 0.0 && dt <= 1.0)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: above 0 and at most 1 s", dt);
    trocar_status status = check_needle(sim, needle, why);
    if (status == TROCAR_OK) status = check_pose(base, &at, why);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    status = catch_up(sim, needle, why);
    if (status == TROCAR_OK) {
        needle_track *track = &sim->needles[needle];
        const compliance_snapshot *snapshot = triple_buffer_read(&track->snapshots, NULL);
        run_tick(sim, needle, snapshot, at, dt, output); /* if the insertion has started over, it simply goes on */
        status = respond(sim, track, dt, why);
        other_loads others;
        list_others(sim, needle, &others);
        bool same = snapshot->serial == track->state.request.serial;
        same = same && track->served_changes == attached_changes(sim);
        bool known = others.count == 0 && (others.attached || others.pressed ? track->served_shifts == attached_shifts(sim) : !snapshot->loaded);
        if (status == TROCAR_OK && !(same && known)) status = answer_and_publish(sim, needle, why);
    }
    restore_floating_mode(before);
    return status;
}

/* Answers the newest request of this needle, if there is one: first the rows, then line after line what the mesh resolves, until there is a
   newer one. The first line, which is the tip's, is always measured: a worker so slow that there is always a newer one would never measure any. */
static trocar_status answer_request(trocar_sim *sim, int index, trocar_work *work, report *why) {
    bool fresh;
    needle_track *needle = &sim->needles[index];
    if (needle->attached) return TROCAR_OK;
    const posted_request *posted = triple_buffer_read(&needle->requests, &fresh);
    if (!fresh) return TROCAR_OK;
    floating_mode before = flush_denormals();
    const remesh_request *request = &posted->request;
    trocar_status status = start_anew_if_changed(sim, needle, why);
    if (status == TROCAR_OK) status = remesher_serve(needle->remesher, request, triple_buffer_slot(&needle->snapshots), why);
    if (status == TROCAR_OK) status = fill_free(sim, index, request, true, why);
    if (status == TROCAR_OK) triple_buffer_publish(&needle->snapshots);
    if (status == TROCAR_OK && sim->clock) work->latency = sim->clock() - posted->asked;
    for (int lines = 0; status == TROCAR_OK && remesher_must_measure(needle->remesher, request); lines++) {
        if (lines > 0 && triple_buffer_waits(&needle->requests)) break;
        status = remesher_measure(needle->remesher, request, 1, triple_buffer_slot(&needle->snapshots), why);
        if (status == TROCAR_OK) status = fill_free(sim, index, request, false, why);
        if (status == TROCAR_OK) triple_buffer_publish(&needle->snapshots);
    }
    restore_floating_mode(before);
    work->more = 1;
    work->answered = status == TROCAR_OK;
    return status;
}

/* The newest forces of held needles. True: some are new. */
static bool take_loads(trocar_sim *sim) {
    bool any = false;
    for (int i = 0; i < sim->needle_count; i++) {
        bool fresh;
        needle_track *needle = &sim->needles[i];
        const tissue_loads *loads = triple_buffer_read(&needle->loads_out, &fresh);
        if (!fresh || needle->attached) continue;
        copy_loads(loads, &needle->held);
        mark_stale(sim, needle);
        any = true;
    }
    return any;
}

/* What rests and the probe respond to the newest loads. */
static trocar_status respond_in_turn(trocar_sim *sim, report *why) {
    sim->to_respond = false;
    sim->answers = 0;
    trocar_status status = press_probe(sim, why);
    return status == TROCAR_OK ? respond_to_loads(sim, false, why) : status;
}

/* One needle slips. True: there is more. */
static bool slip_in_turn(trocar_sim *sim, trocar_status *status, report *why) {
    uint64_t shifts = sim->resting.shifts;
    bool more = slip_some(sim, false);
    if (sim->resting.shifts != shifts) *status = press_probe(sim, why);
    return more;
}

static bool look_ahead(trocar_sim *sim) {
    for (int i = 0; i < sim->needle_count; i++)
        if (!sim->needles[i].attached && remesher_look_ahead(sim->needles[i].remesher)) return true;
    return false;
}

/* Does one thing at a time, so that a request never waits for long: it comes first, but not for ever. */
trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    uint64_t count;
    ssize_t taken = read(sim->work_wake, &count, sizeof count);
    (void)taken;
    trocar_work work = {0};
    resting_change change;
    if (take_loads(sim)) sim->to_respond = true;
    if (take_probe_pose(sim)) sim->to_respond = true;
    trocar_status status = change_resting(sim, &change, why);
    work.more = change.any;
    work.kept = change.kept;
    for (int i = 0; i < sim->needle_count && !work.more; i++) {
        int index = sim->next_served;
        sim->next_served = (sim->next_served + 1) % sim->needle_count;
        status = answer_request(sim, index, &work, why);
    }
    sim->answers += work.answered;
    floating_mode before = flush_denormals();
    if (status == TROCAR_OK && (!work.more || change.any || sim->answers >= MOST_ANSWERS)) {
        bool responds = sim->to_respond;
        if (responds) status = respond_in_turn(sim, why);
        else sim->answers = 0;
        if (responds) work.more = true;
        else if (slip_in_turn(sim, &status, why) || look_ahead(sim)) work.more = true;
    }
    restore_floating_mode(before);
    if (done) *done = work;
    return status;
}

int trocar_sim_work_descriptor(const trocar_sim *sim) { return sim->work_wake; }

void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void)) { sim->clock = sim->workspace->profile.clock = clock; }

void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[TROCAR_STAGES]) {
    memcpy(nanoseconds, sim->workspace->profile.spent, sizeof sim->workspace->profile.spent);
}
