/* trocar.h: simulations. */
#include <errno.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "api/api.h"
#include "base/flush_denormals.h"

_Static_assert(TROCAR_MAX_CONTACTS == (int)MAX_CONTACTS && TROCAR_MAX_JOINTS == NEEDLE_MAX_SEGMENTS + 1, "trocar.h says how many");
_Static_assert(TROCAR_EVENT_TOUCHED == (int)EVENT_TOUCHED && TROCAR_EVENT_KEPT == (int)EVENT_KEPT, "trocar.h says which bits");
_Static_assert(TROCAR_STAGES == (int)INSERTION_STAGES && TROCAR_STAGE_WRENCH == (int)INSERTION_WRENCH, "trocar.h says which stages");

/* ---- creation ------------------------------------------------------------------------------------------------------------ */

static trocar_status allocate(trocar_sim *sim, report *why) {
    sim->state = calloc(1, sizeof *sim->state);
    sim->workspace = calloc(1, sizeof *sim->workspace);
    sim->work_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (!sim->state || !sim->workspace) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    if (sim->work_wake < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    memset(sim->state, 0, sizeof *sim->state); /* touched, so that no page fault comes later */
    memset(sim->workspace, 0, sizeof *sim->workspace);
    trocar_status status = triple_buffer_create(&sim->requests, sizeof(posted_request), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&sim->snapshots, sizeof(compliance_snapshot), why);
    if (status != TROCAR_OK) return status;
    return remesher_create(sim->model->parts.inverse, sim->model->parts.config.remeshing, &sim->remesher, why);
}

trocar_status trocar_sim_create(trocar_model *model, trocar_sim **created, trocar_error *error) {
    static const trocar_pose at_origin = {{0, 0, 0}, {1, 0, 0, 0}};
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    if (model->mesh_only) return fail(why, TROCAR_BAD_INPUT, "this model is its mesh alone: create it without mesh_only");
    trocar_sim *sim = aligned_alloc(CACHE_LINE, (sizeof *sim + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE);
    if (!sim) return fail(why, TROCAR_NO_MEMORY, "no memory for a simulation");
    memset(sim, 0, sizeof *sim);
    sim->model = model;
    sim->work_wake = -1;
    trocar_status status = allocate(sim, why);
    if (status == TROCAR_OK) status = trocar_sim_reset(sim, 0, &at_origin, why);
    if (status == TROCAR_OK) *created = sim;
    else trocar_sim_free(sim);
    return status;
}

void trocar_sim_free(trocar_sim *sim) {
    if (!sim) return;
    remesher_free(sim->remesher);
    triple_buffer_free(&sim->requests);
    triple_buffer_free(&sim->snapshots);
    if (sim->work_wake >= 0) close(sim->work_wake);
    free(sim->state);
    free(sim->workspace);
    free(sim->field_scratch);
    free(sim->added_field);
    free(sim);
}

/* ---- ticks --------------------------------------------------------------------------------------------------------------- */

/* RT */
static trocar_status check_pose(int needle, const trocar_pose *p, pose *out, report *why) {
    double norm = 0.0, sum = 0.0;
    for (int i = 0; i < 4; i++) norm += p->orientation[i] * p->orientation[i];
    for (int i = 0; i < 3; i++) sum += p->position[i];
    if (needle == 0 && isfinite(sum) && fabs(sqrt(norm) - 1.0) <= 1e-3) {
        quat q = {p->orientation[0], p->orientation[1], p->orientation[2], p->orientation[3]};
        bool unit = fabs(norm - 1.0) <= 8 * DBL_EPSILON; /* as it comes out of q_unit: normalising it again could change its last bit */
        *out = (pose){v3(p->position[0], p->position[1], p->position[2]), unit ? q : q_unit(q)};
        return TROCAR_OK;
    }
    if (!why) return TROCAR_BAD_INPUT;
    if (needle != 0) return fail(why, TROCAR_BAD_INPUT, "needle %d: there is one, number 0", needle);
    if (!isfinite(sum) || !isfinite(norm)) return fail(why, TROCAR_BAD_INPUT, "the pose is not finite");
    return fail(why, TROCAR_BAD_INPUT, "the orientation's length is %g: w x y z must be of unit length", sqrt(norm));
}

trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error) {
    pose at;
    trocar_status status = check_pose(needle, base, &at, error);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    sim->given = at;
    insertion_reset(&sim->model->parts.insertion, at, sim->state);
    restore_floating_mode(before);
    return TROCAR_OK;
}

static void answer(const insertion_wrench *wrench, trocar_output *output) {
    *output = (trocar_output){.force = {wrench->force.x, wrench->force.y, wrench->force.z},
                              .torque = {wrench->torque.x, wrench->torque.y, wrench->torque.z}, .depth = wrench->depth,
                              .contacts = wrench->contacts, .events = wrench->events, .membrane = wrench->membrane, .passes = wrench->passes,
                              .switches = wrench->switches};
}

/* Hands the worker what the tick wants to know next, if that has changed. RT */
static void post_request(trocar_sim *sim) {
    if (sim->state->request.serial == sim->posted) return;
    posted_request *slot = triple_buffer_slot(&sim->requests);
    int64_t asked = slot->asked = sim->clock ? sim->clock() : 0;
    uint64_t serial = sim->state->request.serial;
    slot->request = sim->state->request;
    triple_buffer_publish(&sim->requests);
    if (serial - sim->posted > REQUESTS_REMEMBERED) sim->posted = serial - REQUESTS_REMEMBERED; /* after a restore */
    while (sim->posted < serial) sim->asked[++sim->posted % REQUESTS_REMEMBERED] = asked;
    uint64_t one = 1;
    ssize_t written = write(sim->work_wake, &one, sizeof one); /* fails only when the counter is full: awake anyway */
    (void)written;
}

/* One tick with what `snapshot` knows of the tissue. A number that is not finite would stay in the state: then the insertion starts
   over, and the answer is NUMERIC. RT */
static trocar_status run_tick(trocar_sim *sim, const compliance_snapshot *snapshot, pose base, double dt, trocar_output *output) {
    insertion_wrench wrench;
    floating_mode before = flush_denormals();
    sim->given = base;
    insertion_tick(&sim->model->parts.insertion, sim->state, sim->workspace, snapshot, base, dt, &wrench);
    bool finite = insertion_is_finite(sim->state, &wrench);
    if (!finite) insertion_start_over(&sim->model->parts.insertion, base, sim->state, &wrench);
    restore_floating_mode(before);
    sim->answered = snapshot->serial;
    answer(&wrench, output);
    return finite ? TROCAR_OK : TROCAR_NUMERIC;
}

trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0) || check_pose(needle, base, &at, NULL) != TROCAR_OK) return TROCAR_BAD_INPUT;
    trocar_status status = run_tick(sim, triple_buffer_read(&sim->snapshots, NULL), at, dt, output);
    post_request(sim);
    return status;
}

void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance) {
    if (needle == 0) sim->state->base_compliance = compliance;
}

int64_t trocar_sim_waiting(const trocar_sim *sim) {
    if (!sim->clock || sim->answered >= sim->posted) return 0;
    uint64_t oldest = sim->posted - sim->answered < REQUESTS_REMEMBERED ? sim->answered + 1 : sim->posted + 1; /* or the oldest remembered */
    return sim->clock() - sim->asked[oldest % REQUESTS_REMEMBERED];
}

/* Serves `request` into the next snapshot. Worker's side. */
static trocar_status serve(trocar_sim *sim, const remesh_request *request, report *why) {
    floating_mode before = flush_denormals();
    trocar_status status = remesher_serve(sim->remesher, request, triple_buffer_slot(&sim->snapshots), why);
    restore_floating_mode(before);
    if (status == TROCAR_OK) triple_buffer_publish(&sim->snapshots);
    return status;
}

trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    pose at;
    if (!(dt > 0.0 && dt <= 1.0)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: above 0 and at most 1 s", dt);
    trocar_status status = check_pose(needle, base, &at, why);
    if (status != TROCAR_OK) return status;
    const compliance_snapshot *snapshot = triple_buffer_read(&sim->snapshots, NULL);
    run_tick(sim, snapshot, at, dt, output); /* an insertion that has started over goes on */
    if (snapshot->serial == sim->state->request.serial) return TROCAR_OK;
    return serve(sim, &sim->state->request, why);
}

trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    uint64_t count;
    ssize_t taken = read(sim->work_wake, &count, sizeof count);
    (void)taken;
    bool fresh;
    const posted_request *posted = triple_buffer_read(&sim->requests, &fresh);
    trocar_work work = {.answered = fresh, .more = 1};
    trocar_status status = TROCAR_OK;
    if (fresh) {
        status = serve(sim, &posted->request, why);
        work.answered = status == TROCAR_OK;
        if (work.answered && sim->clock) work.latency = sim->clock() - posted->asked;
    } else {
        floating_mode before = flush_denormals();
        work.more = remesher_look_ahead(sim->remesher);
        restore_floating_mode(before);
    }
    if (done) *done = work;
    return status;
}

int trocar_sim_work_descriptor(const trocar_sim *sim) { return sim->work_wake; }

void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void)) { sim->clock = sim->workspace->profile.clock = clock; }

void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[TROCAR_STAGES]) {
    memcpy(nanoseconds, sim->workspace->profile.spent, sizeof sim->workspace->profile.spent);
}

/* ---- save and restore -------------------------------------------------------------------------------------------------------- */

typedef struct {
    const trocar_model *model;
    insertion_state state;
    compliance_snapshot snapshot;
} saved_state;

size_t trocar_sim_state_size(const trocar_sim *sim) {
    (void)sim;
    return sizeof(saved_state);
}

trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (size != sizeof(saved_state)) return fail(why, TROCAR_BAD_INPUT, "a state has %zu bytes, not %zu", sizeof(saved_state), size);
    memcpy((char *)state + offsetof(saved_state, model), &sim->model, sizeof sim->model);
    memcpy((char *)state + offsetof(saved_state, state), sim->state, sizeof *sim->state);
    memcpy((char *)state + offsetof(saved_state, snapshot), triple_buffer_read((triple_buffer *)&sim->snapshots, NULL), sizeof(compliance_snapshot));
    return TROCAR_OK;
}

trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    const trocar_model *model;
    if (size != sizeof(saved_state)) return fail(why, TROCAR_BAD_INPUT, "a state has %zu bytes, not %zu", sizeof(saved_state), size);
    memcpy(&model, (const char *)state + offsetof(saved_state, model), sizeof model);
    if (model != sim->model) return fail(why, TROCAR_BAD_INPUT, "the state is that of another model");
    compliance_snapshot *slot = triple_buffer_slot(&sim->snapshots);
    memcpy(sim->state, (const char *)state + offsetof(saved_state, state), sizeof *sim->state);
    memcpy(slot, (const char *)state + offsetof(saved_state, snapshot), sizeof *slot);
    sim->given = sim->state->needle.base;
    sim->given.position = v3_sub(sim->given.position, sim->state->base_shift);
    floating_mode before = flush_denormals();
    trocar_status status = remesher_resume(sim->remesher, &sim->state->request, slot, why);
    restore_floating_mode(before);
    triple_buffer_publish(&sim->snapshots);
    sim->posted = 0;
    return status;
}

/* ---- what there is to see -------------------------------------------------------------------------------------------------- */

static void put(vec3 v, double out[3]) {
    out[0] = v.x;
    out[1] = v.y;
    out[2] = v.z;
}

int contacts_of(const trocar_model *parent, const insertion_state *s, int needle, trocar_contact *contacts, int room) {
    const needle_model *model = &parent->parts.needle;
    if (needle != 0) return 0;
    for (int i = 0; i < s->active && i < room; i++) {
        const shaft_contact *c = &s->contacts[i];
        contacts[i] = (trocar_contact){.kind = TROCAR_CONTACT_TISSUE, .state = c->friction, .arc = c->arc, .depth = c->depth};
        put(needle_at(model, &s->needle, c->arc).position, contacts[i].position);
        put(c->force, contacts[i].force);
    }
    if (s->tip.phase != TIP_INSIDE) return s->active;
    if (s->active < room) {
        contacts[s->active] = (trocar_contact){.kind = TROCAR_CONTACT_TIP, .state = s->tip.friction, .arc = model->given.length, .depth = s->tip.depth};
        put(s->needle.joints[model->given.segments], contacts[s->active].position);
        put(s->tip.force, contacts[s->active].force);
    }
    return s->active + 1;
}

int centreline_of(const trocar_model *model, const insertion_state *state, int needle, double *joints, int room) {
    int count = model->parts.needle.given.segments + 1;
    if (needle != 0) return 0;
    for (int j = 0; j < count && j < room; j++) put(state->needle.joints[j], joints + 3 * j);
    return count;
}

trocar_pose pose_out(pose base) {
    vec3 x = base.position;
    quat q = base.orientation;
    return (trocar_pose){{x.x, x.y, x.z}, {q.w, q.x, q.y, q.z}};
}

int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    return contacts_of(sim->model, sim->state, needle, contacts, room);
}

int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room) {
    return centreline_of(sim->model, sim->state, needle, joints, room);
}

static const pose AT_ORIGIN = {{0, 0, 0}, {1, 0, 0, 0}};

trocar_pose trocar_sim_base(const trocar_sim *sim, int needle) {
    pose base = needle == 0 ? sim->given : AT_ORIGIN;
    if (needle == 0) base.position = v3_add(base.position, sim->state->base_shift);
    return pose_out(base);
}

double trocar_sim_needle_energy(const trocar_sim *sim, int needle) {
    return needle == 0 ? needle_energy(&sim->model->parts.needle, &sim->state->needle) : 0.0;
}

trocar_status trocar_sim_displacements(trocar_sim *sim, double *displacements, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    simulation *parts = &sim->model->parts;
    if (!sim->field_scratch) sim->field_scratch = malloc(simulation_field_scratch(parts) * sizeof *sim->field_scratch);
    if (!sim->added_field) sim->added_field = malloc(MAX_CONTACTS * sizeof *sim->added_field);
    if (!sim->field_scratch || !sim->added_field) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements");
    floating_mode before = flush_denormals();
    simulation_field(parts, sim->state, sim->field_scratch, (vec3 *)(void *)displacements, sim->added_field);
    restore_floating_mode(before);
    return TROCAR_OK;
}
