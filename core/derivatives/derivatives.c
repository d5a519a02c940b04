/* Implements trocar/derivatives.h. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "api/ticking.h"
#include "insertion/derivatives/tick_derivatives.h"
#include "insertion/step/loads.h"
#include "refinement/refined_field.h"
#include "tissue/region_forces.h"

static const double SAME_TIME = 1e-6; /* rounding tolerance: a tick that exceeds one step by less than this fraction of a step is not divided */

_Static_assert(TROCAR_BASE_VARIABLES == (int)BASE_VARIABLES && TROCAR_MAX_PARAMETERS == MAX_VARIABLES - BASE_VARIABLES, "limits differ from the header's");
_Static_assert(TROCAR_CUTTING_FORCE == (int)CUTTING_FORCE && TROCAR_YOUNGS_MODULUS == (int)YOUNGS_MODULUS, "the order differs from the header's");

typedef struct {
    const trocar_sim *sim;
    const trocar_derivative_request *request;
    const trocar_derivatives *results;
    const int *elements;     /* [T], tetrahedron of each target */
} derivative_call;

/* Interpolates a nodal field at a point in a tetrahedron. `weights` are the point's barycentric coordinates. */
static vec3 field_at(const mesh *m, int tet, const double weights[4], const vec3 *field) {
    vec3 sum = v3(0, 0, 0);
    for (int c = 0; c < 4; c++) sum = v3_axpy(weights[c], field[m->tets[tet][c]], sum);
    return sum;
}

/* ---- targets ---------------------------------------------------------------------------------------------------------------- */

/* The needle's refined mesh, and nodal vectors on it. */
typedef struct {
    refinement refined;
    vec3 added_force[MAX_CONTACTS], added[MAX_CONTACTS]; /* N and m, at the contact nodes */
    vec3 *force, *displacement, *scratch;                /* N and m, at the nodes of the mesh; `scratch` is for refined_displacement */
} refined_scratch;

/* Computes the derivatives of one target's position. By reciprocity, the target's displacement along an axis equals the work done by the needle's forces on
   the displacements that a unit force at the target along that axis would cause. */
static void differentiate_target(const derivative_call *call, const insertion_state *state, int guided, const tick_derivatives *derivatives, int target,
                                 refined_scratch *scratch) {
    const model_parts *parts = call->sim->elasticity.to.parts;
    const mesh *m = &parts->mesh;
    int variables = derivatives->count, tet = call->elements[target], contacts = scratch->refined.count;
    const double *x = call->request->targets + 3 * target;
    double weights[4];
    mesh_barycentric(m, tet, v3(x[0], x[1], x[2]), weights);
    for (int axis = 0; axis < 3; axis++) {
        double *row = call->results->targets + (3 * target + axis) * variables;
        memset(scratch->force, 0, (size_t)m->node_count * sizeof *scratch->force);
        memset(scratch->added_force, 0, sizeof scratch->added_force);
        for (int c = 0; c < 4; c++) scratch->force[m->tets[tet][c]] = v3(weights[c] * (axis == 0), weights[c] * (axis == 1), weights[c] * (axis == 2));
        refined_displacement(parts->inverse, &scratch->refined, (refined_vectors){scratch->force, scratch->added_force}, scratch->scratch,
                             (refined_vectors){scratch->displacement, scratch->added});
        bool tip = state->tip.place.phase == TIP_INSIDE && state->tip.known.tet >= 0;
        vec3 at_tip = tip ? field_at(m, state->tip.known.tet, state->tip.known.weights, scratch->displacement) : v3(0, 0, 0);
        for (int v = 0; v < variables; v++) {
            row[v] = tip ? v3_dot(at_tip, derivatives->of[v].load[guided + contacts]) : 0.0;
            for (int k = 0; k < contacts; k++) row[v] += v3_dot(scratch->added[k], derivatives->of[v].load[guided + k]);
        }
    }
}

static trocar_status differentiate_targets(const derivative_call *call, const insertion_state *state, int guided, const tick_derivatives *derivatives, trocar_error *why) {
    if (!call->results->targets || call->request->target_count == 0) return TROCAR_OK;
    const model_parts *parts = call->sim->elasticity.to.parts;
    size_t nodes = (size_t)parts->mesh.node_count;
    vec3 *memory = malloc((2 * nodes + model_parts_field_scratch(parts)) * sizeof *memory);
    refined_scratch *scratch = malloc(sizeof *scratch);
    trocar_status status = memory && scratch ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    if (status == TROCAR_OK) {
        scratch->force = memory;
        scratch->displacement = memory + nodes;
        scratch->scratch = memory + 2 * nodes;
        insertion_refinement(state, &scratch->refined);
        for (int t = 0; t < call->request->target_count; t++) differentiate_target(call, state, guided, derivatives, t, scratch);
    }
    free(memory);
    free(scratch);
    return status;
}

/* ---- moduli ------------------------------------------------------------------------------------------------------------------ */

/* Computes `change`, the derivative (m/Pa, node_count entries) of the displacements u with respect to a region's modulus E at constant forces: -K^-1 dK/dE u,
   where dK/dE is the region's part of K divided by E. `scratch` has node_count entries. */
static trocar_status soften(const derivative_call *call, int region, const vec3 *u, vec3 *scratch, vec3 *change, trocar_error *why) {
    const model_parts *parts = call->sim->elasticity.to.parts;
    trocar_status status = region_forces(&parts->tissue, region, u, scratch, why);
    if (status != TROCAR_OK) return status;
    for (int i = 0; i < parts->mesh.node_count; i++) scratch[i] = v3_scale(-1.0 / parts->materials[region].youngs_modulus, scratch[i]);
    inverse_apply(parts->inverse, scratch, change);
    return TROCAR_OK;
}

/* Interpolates a nodal field at the points where the needle loads the tissue. */
static void at_points(const mesh *m, const tissue_loads *places, int guided, const vec3 *field, vec3 moved[MAX_POINTS]) {
    for (int i = 0; i < places->count; i++) moved[guided + i] = field_at(m, places->loads[i].tet, places->loads[i].weights, field);
}

static int moduli_in(const tick_derivatives *derivatives) {
    int sum = 0;
    for (int i = 0; i < derivatives->count - BASE_VARIABLES; i++) sum += derivatives->parameters[i].property == YOUNGS_MODULUS;
    return sum;
}

/* Fills derivatives->moved. `fields` receives one field of displacement derivatives for each parameter that is a modulus, in the order of the parameters; the
   caller must free it. */
static trocar_status differentiate_mesh(const derivative_call *call, const insertion_state *state, int guided, tick_derivatives *derivatives, vec3 **fields, trocar_error *why) {
    const model_parts *parts = call->sim->elasticity.to.parts;
    size_t nodes = (size_t)parts->mesh.node_count, moduli = (size_t)moduli_in(derivatives);
    *fields = NULL;
    memset(derivatives->moved, 0, sizeof derivatives->moved);
    if (moduli == 0) return TROCAR_OK;
    vec3 *u = malloc(2 * nodes * sizeof *u);
    tissue_loads *places = malloc(sizeof *places);
    *fields = malloc(moduli * nodes * sizeof **fields);
    trocar_status status = u && places && *fields ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    if (status == TROCAR_OK) status = trocar_view_displacements(&call->sim->view, &u->x, why);
    if (status == TROCAR_OK) insertion_place_loads(&parts->insertion, state, places);
    for (int i = 0, modulus = 0; i < derivatives->count - BASE_VARIABLES && status == TROCAR_OK; i++) {
        if (derivatives->parameters[i].property != YOUNGS_MODULUS) continue;
        vec3 *change = *fields + nodes * (size_t)modulus++;
        status = soften(call, derivatives->parameters[i].region, u, u + nodes, change, why);
        if (status == TROCAR_OK) at_points(&parts->mesh, places, guided, change, derivatives->moved[i]);
    }
    free(u);
    free(places);
    return status;
}

/* Adds to the targets' derivatives the direct effect of the moduli, at constant forces. */
static void add_fields(const derivative_call *call, const tick_derivatives *derivatives, const vec3 *fields) {
    const mesh *m = &call->sim->model->parts.mesh;
    for (int i = 0, modulus = 0; i < derivatives->count - BASE_VARIABLES; i++) {
        if (derivatives->parameters[i].property != YOUNGS_MODULUS) continue;
        const vec3 *field = fields + (size_t)m->node_count * (size_t)modulus++;
        for (int t = 0; t < call->request->target_count; t++) {
            const double *x = call->request->targets + 3 * t;
            double weights[4], *to = call->results->targets + 3 * t * derivatives->count + BASE_VARIABLES + i;
            mesh_barycentric(m, call->elements[t], v3(x[0], x[1], x[2]), weights);
            vec3 change = field_at(m, call->elements[t], weights, field);
            for (int axis = 0; axis < 3; axis++) to[axis * derivatives->count] += (&change.x)[axis];
        }
    }
}

/* ---- the step --------------------------------------------------------------------------------------------------------------- */

/* Writes a vector to column `v`, rows `first` to `first` + 2. */
static void put(double *rows, int variables, int v, int first, vec3 x) {
    if (!rows) return;
    rows[(first + 0) * variables + v] = x.x;
    rows[(first + 1) * variables + v] = x.y;
    rows[(first + 2) * variables + v] = x.z;
}

static trocar_status differentiate(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, void *context, trocar_error *why) {
    const derivative_call *call = context;
    const trocar_derivatives *to = call->results;
    tick_derivatives *found = malloc(sizeof *found);
    if (!found) return fail(why, TROCAR_NO_MEMORY, "no memory for derivatives");
    found->count = BASE_VARIABLES + call->request->parameter_count;
    for (int i = 0; i < call->request->parameter_count; i++)
        found->parameters[i] = (tissue_parameter){(region_property)call->request->parameters[i].property, call->request->parameters[i].region};
    vec3 *fields;
    trocar_status status = differentiate_mesh(call, state, workspace->points.guided, found, &fields, why);
    if (status == TROCAR_OK) status = insertion_differentiate(tick, state, workspace, found, why);
    for (int v = 0; v < found->count && status == TROCAR_OK; v++) {
        const variable_derivatives *of = &found->of[v];
        put(to->wrench, found->count, v, 0, of->force);
        put(to->wrench, found->count, v, 3, of->torque);
        put(to->tip, found->count, v, 0, of->tip);
        put(to->direction, found->count, v, 0, of->direction);
        if (to->range && v < BASE_VARIABLES) to->range[v] = of->range;
    }
    if (status == TROCAR_OK) status = differentiate_targets(call, state, workspace->points.guided, found, why);
    if (status == TROCAR_OK && fields && to->targets) add_fields(call, found, fields);
    free(fields);
    free(found);
    return status;
}

static trocar_status locate_targets(const trocar_sim *sim, const trocar_derivative_request *request, int *elements, trocar_error *why) {
    for (int t = 0; t < request->target_count; t++) {
        const double *x = request->targets + 3 * t;
        bool finite = isfinite(x[0] + x[1] + x[2]);
        elements[t] = finite ? mesh_locate(&sim->model->parts.mesh, v3(x[0], x[1], x[2]), -1) : -1;
        if (elements[t] < 0) return fail(why, TROCAR_BAD_INPUT, "target %d, at %g %g %g m, is outside the tissue at rest", t, x[0], x[1], x[2]);
    }
    return TROCAR_OK;
}

static trocar_status check_request(const trocar_sim *sim, const trocar_derivative_request *request, trocar_error *why) {
    if (request->target_count < 0) return fail(why, TROCAR_BAD_INPUT, "%d targets: expected 0 or more", request->target_count);
    if (request->parameter_count < 0 || request->parameter_count > TROCAR_MAX_PARAMETERS)
        return fail(why, TROCAR_BAD_INPUT, "%d parameters: expected 0 to %d", request->parameter_count, (int)TROCAR_MAX_PARAMETERS);
    const insertion_model *model = ticking_model(sim);
    if (elasticity_left(&sim->elasticity) > 0.0) return fail(why, TROCAR_BAD_INPUT, "the tissue's moduli are changing: wait until they have their new values");
    for (int i = 0; i < request->parameter_count; i++) {
        const trocar_parameter *p = &request->parameters[i];
        if (p->property == TROCAR_YOUNGS_MODULUS && (model->creep.count > 0 || model->stiffens))
            return fail(why, TROCAR_BAD_INPUT, "parameter %d: moduli of relaxing or stiffening tissue are not differentiated", i);
        if (p->property < 0 || p->property >= (int)PROPERTIES) return fail(why, TROCAR_BAD_INPUT, "parameter %d: there is no property %d", i, p->property);
        if (trocar_model_region_dimension(sim->model, p->region) != 3) return fail(why, TROCAR_BAD_INPUT, "parameter %d: region %d is not a volume", i, p->region);
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
    trocar_status status = check_request(sim, request, why);
    if (status != TROCAR_OK) return status;
    int *elements = malloc((size_t)(request->target_count + 1) * sizeof *elements);
    if (!elements) return fail(why, TROCAR_NO_MEMORY, "no memory for %d targets", request->target_count);
    derivative_call call = {sim, request, derivatives, elements};
    status = locate_targets(sim, request, elements, why);
    if (status == TROCAR_OK) status = sim_step(sim, needle, base, dt, &(after_tick){differentiate, &call}, output, why);
    free(elements);
    return status;
}
