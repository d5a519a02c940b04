/* trocar/derivatives.h: a step with derivatives. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "insertion/derivatives/tick_derivatives.h"
#include "insertion/step/loads.h"

static const double SAME_TIME = 1e-6; /* steps: a tick that exceeds one step by less than this is not divided. Rounding tolerance */

_Static_assert(TROCAR_BASE_VARIABLES == (int)BASE_VARIABLES, "trocar/derivatives.h");

typedef struct {
    const trocar_sim *sim;
    const trocar_derivative_request *request;
    const trocar_derivatives *results;
    const int *elements;     /* [T], element of each target */
} derivative_call;

/* ---- targets ---------------------------------------------------------------------------------------------------------------- */

/* Scratch vectors for each node. */
typedef struct {
    vec3 *force, *displacement;
} nodal_scratch;

/* By reciprocity, the displacement of a target along an axis under forces is their work in the field of a unit force along the axis at the target. */
static void differentiate_target(const derivative_call *call, const tissue_loads *places, int skipped, const tick_derivatives *derivatives, int target,
                                 nodal_scratch scratch) {
    const model_parts *parts = &call->sim->model->parts;
    const mesh *m = &parts->mesh;
    int variables = derivatives->count, tet = call->elements[target];
    double weights[4];
    const double *x = call->request->targets + 3 * target;
    mesh_barycentric(m, tet, v3(x[0], x[1], x[2]), weights);
    for (int axis = 0; axis < 3; axis++) {
        double *row = call->results->targets + (3 * target + axis) * variables;
        memset(scratch.force, 0, (size_t)m->node_count * sizeof *scratch.force);
        for (int c = 0; c < 4; c++) scratch.force[m->tets[tet][c]] = v3(weights[c] * (axis == 0), weights[c] * (axis == 1), weights[c] * (axis == 2));
        inverse_apply(parts->inverse, scratch.force, scratch.displacement);
        for (int v = 0; v < variables; v++) row[v] = 0.0;
        for (int i = 0; i < places->count; i++) {
            vec3 moved = v3(0, 0, 0);
            for (int c = 0; c < 4; c++) moved = v3_axpy(places->loads[i].weights[c], scratch.displacement[m->tets[places->loads[i].tet][c]], moved);
            for (int v = 0; v < variables; v++) row[v] += v3_dot(moved, derivatives->of[v].load[skipped + i]);
        }
    }
}

static trocar_status differentiate_targets(const derivative_call *call, const insertion_state *state, int guided, const tick_derivatives *derivatives, report *why) {
    if (!call->results->targets || call->request->target_count == 0) return TROCAR_OK;
    size_t nodes = (size_t)call->sim->model->parts.mesh.node_count;
    vec3 *memory = malloc(2 * nodes * sizeof *memory);
    tissue_loads *places = malloc(sizeof *places);
    trocar_status status = memory && places ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    if (status == TROCAR_OK) insertion_place_loads(&call->sim->model->parts.insertion, state, places);
    for (int t = 0; t < call->request->target_count && status == TROCAR_OK; t++)
        differentiate_target(call, places, guided, derivatives, t, (nodal_scratch){memory, memory + nodes});
    free(memory);
    free(places);
    return status;
}

/* ---- the step --------------------------------------------------------------------------------------------------------------- */

/* Writes a vector to the column of a variable. */
static void put(double *rows, int variables, int v, int first, vec3 x) {
    if (!rows) return;
    rows[(first + 0) * variables + v] = x.x;
    rows[(first + 1) * variables + v] = x.y;
    rows[(first + 2) * variables + v] = x.z;
}

static trocar_status differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, void *context, report *why) {
    const derivative_call *call = context;
    const trocar_derivatives *to = call->results;
    tick_derivatives *found = malloc(sizeof *found);
    if (!found) return fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    trocar_status status = insertion_differentiate(tick, state, workspace, found, why);
    for (int v = 0; v < found->count && status == TROCAR_OK; v++) {
        const variable_derivatives *of = &found->of[v];
        put(to->wrench, found->count, v, 0, of->force);
        put(to->wrench, found->count, v, 3, of->torque);
        put(to->tip, found->count, v, 0, of->tip);
        put(to->direction, found->count, v, 0, of->direction);
        if (to->range) to->range[v] = of->range;
    }
    if (status == TROCAR_OK) status = differentiate_targets(call, state, workspace->points.guided, found, why);
    free(found);
    return status;
}

static trocar_status locate_targets(const trocar_sim *sim, const trocar_derivative_request *request, int *elements, report *why) {
    for (int t = 0; t < request->target_count; t++) {
        const double *x = request->targets + 3 * t;
        bool finite = isfinite(x[0] + x[1] + x[2]);
        elements[t] = finite ? mesh_locate(&sim->model->parts.mesh, v3(x[0], x[1], x[2]), -1) : -1;
        if (elements[t] < 0) return fail(why, TROCAR_BAD_INPUT, "target %d, at %g %g %g m, is outside the tissue at rest", t, x[0], x[1], x[2]);
    }
    return TROCAR_OK;
}

trocar_status trocar_sim_differentiate(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const trocar_derivative_request *request,
                                       trocar_output *output, const trocar_derivatives *derivatives, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    const trocar_derivative_request none = {0};
    if (!request) request = &none;
    double longest = sim->model->parts.insertion.settings.longest_step;
    if (dt > longest * (1.0 + SAME_TIME)) return fail(why, TROCAR_BAD_INPUT, "dt of %g s: only a step of at most %g s has derivatives", dt, longest);
    if (request->target_count < 0 || request->parameter_count != 0) return fail(why, TROCAR_BAD_INPUT, "parameters are not differentiated yet");
    int *elements = malloc((size_t)(request->target_count + 1) * sizeof *elements);
    if (!elements) return fail(why, TROCAR_NO_MEMORY, "no memory for %d targets", request->target_count);
    derivative_call call = {sim, request, derivatives, elements};
    trocar_status status = locate_targets(sim, request, elements, why);
    if (status == TROCAR_OK) status = sim_step(sim, needle, base, dt, &(after_tick){differentiate, &call}, output, why);
    free(elements);
    return status;
}
