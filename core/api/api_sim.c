/* trocar.h: simulations. */
#include <errno.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "api/api.h"
#include "base/flush_denormals.h"
#include "remesh/free_displacement.h"

_Static_assert(TROCAR_MAX_CONTACTS == (int)MAX_CONTACTS && TROCAR_MAX_JOINTS == NEEDLE_MAX_SEGMENTS + 1 && TROCAR_MAX_NEEDLES == (int)MAX_NEEDLES,
               "limits differ from trocar.h");
_Static_assert(TROCAR_MAX_GUIDES == (int)MAX_GUIDES && TROCAR_MAX_POINTS == (int)MAX_POINTS, "limits differ from trocar.h");
_Static_assert(TROCAR_CONTACT_TISSUE == (int)POINT_TISSUE && TROCAR_CONTACT_TIP == (int)POINT_TIP && TROCAR_CONTACT_GUIDE == (int)POINT_GUIDE, "contact kinds differ from trocar.h");
_Static_assert(TROCAR_EVENT_TOUCHED == (int)EVENT_TOUCHED && TROCAR_EVENT_TRACK_DROPPED == (int)EVENT_TRACK_DROPPED, "event bits differ from trocar.h");
_Static_assert(TROCAR_MAX_TRACKS == (int)MAX_TRACKS && TROCAR_MAX_TRACK_POINTS == (int)MAX_TRACK_POINTS && NO_MEMBRANE == -1, "limits differ from trocar.h");
_Static_assert(TROCAR_STAGES == (int)INSERTION_STAGES && TROCAR_STAGE_WRENCH == (int)INSERTION_WRENCH, "stages differ from trocar.h");

/* ---- creation ------------------------------------------------------------------------------------------------------------ */

static trocar_status create_needle(const trocar_model *model, needle_track *needle, report *why) {
    trocar_status status = triple_buffer_create(&needle->requests, sizeof(posted_request), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&needle->snapshots, sizeof(compliance_snapshot), why);
    if (status != TROCAR_OK) return status;
    return remesher_create(model->parts.inverse, model->parts.config.remeshing, &needle->remesher, why);
}

static trocar_status allocate(trocar_sim *sim, report *why) {
    size_t needles = (size_t)sim->needle_count * sizeof *sim->needles;
    sim->needles = allocate_on_cache_lines(needles); /* touched, so that no page fault comes later */
    sim->workspace = calloc(1, sizeof *sim->workspace);
    sim->work_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (!sim->needles || !sim->workspace) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    if (sim->work_wake < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    memset(sim->workspace, 0, sizeof *sim->workspace);
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) status = create_needle(sim->model, &sim->needles[i], why);
    return status;
}

trocar_status trocar_sim_create(trocar_model *model, trocar_sim **created, trocar_error *error) {
    static const trocar_pose at_origin = {{0, 0, 0}, {1, 0, 0, 0}};
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "this model is its mesh alone: create it without mesh_only");
    trocar_sim *sim = calloc(1, sizeof *sim);
    if (!sim) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    sim->model = model;
    sim->needle_count = model->parts.config.needle_count;
    sim->work_wake = -1;
    trocar_status status = allocate(sim, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
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
    }
    if (sim->work_wake >= 0) close(sim->work_wake);
    free(sim->needles);
    free(sim->workspace);
    free(sim->field_scratch);
    free(sim);
}

/* ---- ticks --------------------------------------------------------------------------------------------------------------- */

trocar_status check_needle(const trocar_sim *sim, int needle, report *why) {
    if (has_needle(sim->model, needle)) return TROCAR_OK;
    if (!why) return TROCAR_BAD_INPUT;
    if (sim->needle_count == 1) return fail(why, TROCAR_BAD_INPUT, "needle %d: there is one, number 0; the scene's \"needles\" says how many", needle);
    return fail(why, TROCAR_BAD_INPUT, "needle %d: there are %d, numbers 0 to %d", needle, sim->needle_count, sim->needle_count - 1);
}

/* RT */
static trocar_status check_pose(const trocar_pose *p, pose *out, report *why) {
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
    sim->needles[needle].given = at;
    insertion_reset(&sim->model->parts.insertion, at, &sim->needles[needle].state);
    seeds_keep(needle, &sim->seeds);
    restore_floating_mode(before);
    return TROCAR_OK;
}

static void answer(const tick_output *wrench, trocar_output *output) {
    *output = (trocar_output){.force = {wrench->force.x, wrench->force.y, wrench->force.z},
                              .torque = {wrench->torque.x, wrench->torque.y, wrench->torque.z}, .depth = wrench->depth,
                              .contacts = wrench->contacts, .events = wrench->events, .membrane = wrench->membrane, .passes = wrench->passes,
                              .switches = wrench->switches};
}

/* Collects the forces of the other needles. RT */
static void collect_others(trocar_sim *sim, int needle) {
    tissue_loads *others = &sim->needles[needle].others;
    others->count = 0;
    for (int i = 0; i < sim->needle_count; i++)
        if (i != needle) insertion_add_loads(&sim->model->parts.insertion, &sim->needles[i].state, others);
}

/* RT */
static void copy_loads(const tissue_loads *from, tissue_loads *to) {
    to->count = from->count;
    memcpy(to->loads, from->loads, (size_t)from->count * sizeof *from->loads);
}

/* Have the other needles' forces changed enough to be worth a request? RT */
static bool others_changed(const needle_track *needle) {
    static const double NOTICEABLE = 1e-3; /* N */
    const tissue_loads *now = &needle->others, *then = &needle->posted_others;
    if (now->count != then->count) return true;
    for (int i = 0; i < now->count; i++)
        if (v3_norm(v3_sub(now->loads[i].force, then->loads[i].force)) > NOTICEABLE) return true;
    return false;
}

/* Hands the worker what the tick wants to know next, if that has changed. RT */
static void post_request(trocar_sim *sim, needle_track *needle) {
    uint64_t serial = needle->state.request.serial;
    if (serial == needle->posted && !others_changed(needle)) return;
    posted_request *slot = triple_buffer_slot(&needle->requests);
    int64_t asked = slot->asked = sim->clock ? sim->clock() : 0;
    slot->request = needle->state.request;
    copy_loads(&needle->others, &slot->others);
    copy_loads(&needle->others, &needle->posted_others);
    triple_buffer_publish(&needle->requests);
    if (serial - needle->posted > REQUESTS_REMEMBERED) needle->posted = serial - REQUESTS_REMEMBERED; /* after a restore */
    while (needle->posted < serial) needle->asked[++needle->posted % REQUESTS_REMEMBERED] = asked;
    uint64_t one = 1;
    ssize_t written = write(sim->work_wake, &one, sizeof one); /* fails only if the counter is full: the worker is awake anyway */
    (void)written;
}

/* One tick with what `snapshot` knows of the tissue. A number that is not finite would stay in the state: then the insertion starts
   over, and the answer is NUMERIC. RT */
static trocar_status run_tick(trocar_sim *sim, int index, const compliance_snapshot *snapshot, pose base, double dt, trocar_output *output) {
    tick_output wrench;
    needle_track *needle = &sim->needles[index];
    const insertion_model *model = &sim->model->parts.insertion;
    floating_mode before = flush_denormals();
    needle->given = base;
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
    collect_others(sim, index);
    restore_floating_mode(before);
    needle->answered = snapshot->serial;
    answer(&wrench, output);
    return finite ? TROCAR_OK : TROCAR_NUMERIC;
}

trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0) || !has_needle(sim->model, needle) || check_pose(base, &at, NULL) != TROCAR_OK) return TROCAR_BAD_INPUT;
    trocar_status status = run_tick(sim, needle, triple_buffer_read(&sim->needles[needle].snapshots, NULL), at, dt, output);
    post_request(sim, &sim->needles[needle]);
    return status;
}

void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance) {
    if (has_needle(sim->model, needle)) sim->needles[needle].base_compliance = compliance;
}

int64_t trocar_sim_waiting(const trocar_sim *sim) {
    int64_t longest = 0;
    for (int i = 0; sim->clock && i < sim->needle_count; i++) {
        const needle_track *n = &sim->needles[i];
        if (n->answered >= n->posted) continue;
        uint64_t oldest = n->posted - n->answered < REQUESTS_REMEMBERED ? n->answered + 1 : n->posted + 1; /* or the oldest remembered */
        int64_t waiting = sim->clock() - n->asked[oldest % REQUESTS_REMEMBERED];
        if (waiting > longest) longest = waiting;
    }
    return longest;
}

/* Hands the next snapshot to the tick if it could be filled: the first one that answers this request, or one that knows more. Worker's side. */
static trocar_status publish(trocar_sim *sim, needle_track *needle, trocar_status status, const remesh_request *request, const tissue_loads *others,
                             bool first, report *why) {
    compliance_snapshot *snapshot = triple_buffer_slot(&needle->snapshots);
    if (status == TROCAR_OK && first) {
        status = free_displacement_find(sim->model->parts.inverse, request, others, snapshot, why);
        needle->loaded = snapshot->loaded;
        memcpy(needle->u_free, snapshot->u_free, sizeof needle->u_free);
    } else {
        snapshot->loaded = needle->loaded;
        memcpy(snapshot->u_free, needle->u_free, sizeof snapshot->u_free);
    }
    if (status == TROCAR_OK) triple_buffer_publish(&needle->snapshots);
    return status;
}

trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    pose at;
    if (!(dt > 0.0 && dt <= 1.0)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: above 0 and at most 1 s", dt);
    trocar_status status = check_needle(sim, needle, why);
    if (status == TROCAR_OK) status = check_pose(base, &at, why);
    if (status != TROCAR_OK) return status;
    needle_track *track = &sim->needles[needle];
    const compliance_snapshot *snapshot = triple_buffer_read(&track->snapshots, NULL);
    run_tick(sim, needle, snapshot, at, dt, output); /* if the insertion has started over, it simply goes on */
    bool same = snapshot->serial == track->state.request.serial, alone = track->others.count == 0 && !snapshot->loaded;
    if (same && alone) return TROCAR_OK;
    floating_mode before = flush_denormals();
    status = remesher_answer(track->remesher, &track->state.request, triple_buffer_slot(&track->snapshots), why);
    status = publish(sim, track, status, &track->state.request, &track->others, true, why);
    restore_floating_mode(before);
    return status;
}

/* Answers the newest request of this needle, if there is one: first the rows, then line after line what the mesh resolves, until there is a
   newer one. */
static trocar_status answer_request(trocar_sim *sim, needle_track *needle, trocar_work *work, report *why) {
    bool fresh;
    const posted_request *posted = triple_buffer_read(&needle->requests, &fresh);
    if (!fresh) return TROCAR_OK;
    floating_mode before = flush_denormals();
    const remesh_request *request = &posted->request;
    trocar_status status = remesher_serve(needle->remesher, request, triple_buffer_slot(&needle->snapshots), why);
    status = publish(sim, needle, status, request, &posted->others, true, why);
    if (status == TROCAR_OK && sim->clock) work->latency = sim->clock() - posted->asked;
    while (status == TROCAR_OK && remesher_must_measure(needle->remesher, request) && !triple_buffer_waits(&needle->requests)) {
        status = remesher_measure(needle->remesher, request, 1, triple_buffer_slot(&needle->snapshots), why);
        status = publish(sim, needle, status, request, &posted->others, false, why);
    }
    restore_floating_mode(before);
    work->more = 1;
    work->answered = status == TROCAR_OK;
    return status;
}

trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    uint64_t count;
    ssize_t taken = read(sim->work_wake, &count, sizeof count);
    (void)taken;
    trocar_work work = {0};
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < sim->needle_count && !work.more; i++) {
        needle_track *needle = &sim->needles[sim->next_served];
        sim->next_served = (sim->next_served + 1) % sim->needle_count;
        status = answer_request(sim, needle, &work, why);
    }
    floating_mode before = flush_denormals();
    for (int i = 0; i < sim->needle_count && !work.more; i++) work.more = remesher_look_ahead(sim->needles[i].remesher);
    restore_floating_mode(before);
    if (done) *done = work;
    return status;
}

int trocar_sim_work_descriptor(const trocar_sim *sim) { return sim->work_wake; }

void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void)) { sim->clock = sim->workspace->profile.clock = clock; }

void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[TROCAR_STAGES]) {
    memcpy(nanoseconds, sim->workspace->profile.spent, sizeof sim->workspace->profile.spent);
}
