/* trocar.h: simulations. */
#include <errno.h>
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
    trocar_status status = triple_buffer_create(&sim->requests, sizeof(remesh_request), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&sim->snapshots, sizeof(compliance_snapshot), why);
    if (status != TROCAR_OK) return status;
    return remesher_create(sim->model->parts.inverse, sim->model->parts.config.remeshing, &sim->remesher, why);
}

trocar_status trocar_sim_create(trocar_model *model, trocar_sim **created, trocar_error *error) {
    static const trocar_pose at_origin = {{0, 0, 0}, {1, 0, 0, 0}};
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
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
        *out = (pose){v3(p->position[0], p->position[1], p->position[2]),
                      q_unit((quat){p->orientation[0], p->orientation[1], p->orientation[2], p->orientation[3]})};
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
    insertion_reset(&sim->model->parts.insertion, at, sim->state);
    restore_floating_mode(before);
    return TROCAR_OK;
}

static void answer(const insertion_wrench *wrench, trocar_output *output) {
    *output = (trocar_output){.force = {wrench->force.x, wrench->force.y, wrench->force.z},
                              .torque = {wrench->torque.x, wrench->torque.y, wrench->torque.z}, .depth = wrench->depth,
                              .contacts = wrench->contacts, .events = wrench->events, .membrane = wrench->membrane, .passes = wrench->passes};
}

/* Hands the worker what the tick wants to know next, if that has changed. RT */
static void post_request(trocar_sim *sim) {
    if (sim->state->request.serial == sim->posted) return;
    remesh_request *slot = triple_buffer_slot(&sim->requests);
    *slot = sim->state->request;
    triple_buffer_publish(&sim->requests);
    sim->posted = slot->serial;
    uint64_t one = 1;
    ssize_t written = write(sim->work_wake, &one, sizeof one); /* fails only when the counter is full: awake anyway */
    (void)written;
}

/* One tick with what `snapshot` knows of the tissue. RT */
static void run_tick(trocar_sim *sim, const compliance_snapshot *snapshot, pose base, double dt, trocar_output *output) {
    insertion_wrench wrench;
    floating_mode before = flush_denormals();
    insertion_tick(&sim->model->parts.insertion, sim->state, sim->workspace, snapshot, base, dt, &wrench);
    restore_floating_mode(before);
    answer(&wrench, output);
}

trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output) {
    pose at;
    if (!(dt > 0.0 && dt <= 1.0) || check_pose(needle, base, &at, NULL) != TROCAR_OK) return TROCAR_BAD_INPUT;
    run_tick(sim, triple_buffer_read(&sim->snapshots, NULL), at, dt, output);
    post_request(sim);
    return TROCAR_OK;
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
    run_tick(sim, snapshot, at, dt, output);
    if (snapshot->serial == sim->state->request.serial) return TROCAR_OK;
    return serve(sim, &sim->state->request, why);
}

trocar_status trocar_sim_work(trocar_sim *sim, int *more, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    uint64_t count;
    ssize_t taken = read(sim->work_wake, &count, sizeof count);
    (void)taken;
    bool fresh, ahead = true;
    const remesh_request *request = triple_buffer_read(&sim->requests, &fresh);
    trocar_status status = TROCAR_OK;
    if (fresh) {
        status = serve(sim, request, why);
    } else {
        floating_mode before = flush_denormals();
        ahead = remesher_look_ahead(sim->remesher);
        restore_floating_mode(before);
    }
    if (more) *more = ahead;
    return status;
}

int trocar_sim_work_descriptor(const trocar_sim *sim) { return sim->work_wake; }

void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void)) { sim->workspace->profile.clock = clock; }

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

int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    const insertion_state *s = sim->state;
    const needle_model *model = &sim->model->parts.needle;
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

int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room) {
    int count = sim->model->parts.needle.given.segments + 1;
    if (needle != 0) return 0;
    for (int j = 0; j < count && j < room; j++) put(sim->state->needle.joints[j], joints + 3 * j);
    return count;
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
