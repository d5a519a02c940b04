#include "probe/probe.h"

#include <stdlib.h>
#include <string.h>

#include "probe/complementarity.h"
#include "remesh/free_displacement.h"

enum { MOST_ITERATIONS = 50, LD = 3 * MAX_PRESSED };
static const double REACH = 0.5;         /* radii: nodes that are closer can take part */
static const double STEP = 0.25;         /* radii: the probe moves at most so far at once, for the closest points to move little */
static const double CONVERGED = 1e-9;    /* m, by which nodes still move */
static const double PENETRATION = 1e-12; /* m */
static const double TURNED = 0.02;       /* rad by which a normal may differ from the direction that is attached */
static const double NOTICEABLE = 1e-5;   /* N */

typedef struct probe_scratch {
    vec3 free_u[MAX_PRESSED], u[MAX_PRESSED], normal[MAX_PRESSED]; /* of the near nodes: displacement without the probe, and with it; */
    double gap[MAX_PRESSED], force[MAX_PRESSED];                   /* m, N */
    int chosen[MAX_PRESSED];                                       /* of the near ones: those of the complementarity problem */
    double matrix[MAX_PRESSED * MAX_PRESSED], right[MAX_PRESSED], z[MAX_PRESSED], pivoting[MAX_PRESSED * (MAX_PRESSED + 2)];
    int nodes[MAX_PRESSED];
    vec3 now[MAX_PRESSED], unloaded[MAX_PRESSED];
    double response[MAX_PRESSED], none[1], zeros[MAX_PRESSED * MAX_PRESSED];
} probe_scratch;

static const mesh *mesh_of(const probe *p) { return inverse_tissue(p->beneath)->mesh; }

/* ---- creation ------------------------------------------------------------------------------------------------------------- */

static trocar_status take_surface(probe *p, int surface, report *why) {
    const mesh_group *group = &mesh_of(p)->groups[surface];
    const tissue *t = inverse_tissue(p->beneath);
    p->surface = malloc((size_t)(group->node_count + 1) * sizeof *p->surface);
    p->surface_tet = malloc((size_t)(group->node_count + 1) * sizeof *p->surface_tet);
    p->compliance = malloc((size_t)LD * LD * sizeof *p->compliance);
    p->scratch = calloc(1, sizeof *p->scratch);
    if (!p->surface || !p->surface_tet || !p->compliance || !p->scratch) return fail(why, TROCAR_NO_MEMORY, "no memory for a probe");
    for (int i = 0; i < group->node_count; i++)
        if (t->dof[group->nodes[i]] >= 0) p->surface[p->surface_count++] = group->nodes[i];
    for (int i = 0; i < mesh_of(p)->tet_count; i++)
        for (int c = 0; c < 4; c++) {
            int *listed = bsearch(&mesh_of(p)->tets[i][c], p->surface, (size_t)p->surface_count, sizeof *p->surface, compare_nodes);
            if (listed) p->surface_tet[listed - p->surface] = i;
        }
    return p->surface_count > 0 ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "probe.surface: all nodes of \"%s\" are fixed", group->name);
}

trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, probe **created, report *why) {
    probe *p = *created = calloc(1, sizeof *p);
    if (!p) return fail(why, TROCAR_NO_MEMORY, "no memory for a probe");
    p->shape = *shape;
    p->beneath = beneath;
    p->state.base.orientation.w = 1.0;
    trocar_status status = take_surface(p, surface, why);
    if (status == TROCAR_OK) status = inverse_create_attached(beneath, &p->inverse, why);
    if (status == TROCAR_OK) {
        p->now = (nodal_forces){0, p->scratch->nodes, p->scratch->now};
        p->unloaded = (nodal_forces){0, p->scratch->nodes, p->scratch->unloaded};
        return TROCAR_OK;
    }
    probe_free(p);
    *created = NULL;
    return status;
}

void probe_free(probe *p) {
    if (!p) return;
    inverse_free(p->inverse);
    free(p->surface);
    free(p->surface_tet);
    free(p->compliance);
    free(p->scratch);
    free(p->load_nodes);
    free(p->load_forces);
    free(p);
}

/* ---- nodes that can take part ------------------------------------------------------------------------------------------------ */

static double gap_at_rest(const probe *p, pose base, int node) {
    vec3 ignored;
    return probe_gap(&p->shape, base, mesh_of(p)->nodes[node], &ignored);
}

static bool is_listed(const probe *p, int node) {
    for (int i = 0; i < p->near_count; i++)
        if (p->near[i] == node) return true;
    return false;
}

static int compare_gaps(const void *a, const void *b) {
    const double *x = a, *y = b;
    return x[0] < y[0] ? -1 : x[0] > y[0] ? 1 : (x[1] > y[1]) - (x[1] < y[1]);
}

/* The closest ones, unless all that matter are listed already. */
static trocar_status list_near(probe *p, pose base, report *why) {
    bool listed = p->near_count > 0;
    for (int i = 0; i < p->surface_count && listed; i++)
        listed = gap_at_rest(p, base, p->surface[i]) > REACH * p->shape.radius || is_listed(p, p->surface[i]);
    if (listed) return TROCAR_OK;
    double (*gaps)[2] = malloc((size_t)p->surface_count * sizeof *gaps); /* and the node */
    if (!gaps) return fail(why, TROCAR_NO_MEMORY, "no memory for the probe's contacts");
    for (int i = 0; i < p->surface_count; i++) gaps[i][0] = gap_at_rest(p, base, p->surface[i]), gaps[i][1] = p->surface[i];
    qsort(gaps, (size_t)p->surface_count, sizeof *gaps, compare_gaps);
    int before[MAX_PRESSED], count = p->surface_count < MAX_PRESSED ? p->surface_count : MAX_PRESSED;
    memcpy(before, p->near, sizeof before);
    for (int i = 0; i < count; i++) p->near[i] = (int)gaps[i][1];
    free(gaps);
    qsort(p->near, (size_t)count, sizeof *p->near, compare_nodes);
    if (count != p->near_count || memcmp(before, p->near, (size_t)count * sizeof *before) != 0) p->compliance_known = false;
    p->near_count = count;
    return TROCAR_OK;
}

static trocar_status find_compliance(probe *p, report *why) {
    if (p->compliance_known) return TROCAR_OK;
    trocar_status status = inverse_gather(p->beneath, &(inverse_blocks){p->near_count, p->near, p->near_count, p->near, p->compliance, LD}, why);
    p->compliance_known = status == TROCAR_OK;
    return status;
}

static vec3 yields(const probe *p, int i, int j, vec3 force) {
    mat3 block = {{{0}}};
    m3_add_block(&block, 1.0, p->compliance + (size_t)(3 * i) * LD + 3 * j, LD);
    return m3_apply(&block, force);
}

/* ---- others' loads -------------------------------------------------------------------------------------------------------------- */

static trocar_status collect_loads(probe *p, const other_loads *others, nodal_forces *loads, report *why) {
    int most = 1 + loads_most_nodes(others);
    if (most > p->load_room) {
        free(p->load_nodes);
        free(p->load_forces);
        p->load_nodes = malloc((size_t)most * sizeof *p->load_nodes);
        p->load_forces = malloc((size_t)most * sizeof *p->load_forces);
        p->load_room = p->load_nodes && p->load_forces ? most : 0;
        if (p->load_room == 0) return fail(why, TROCAR_NO_MEMORY, "no memory for the probe's loads");
    }
    *loads = (nodal_forces){loads_on_nodes(mesh_of(p), others, p->load_nodes, p->load_forces), p->load_nodes, p->load_forces};
    return TROCAR_OK;
}

static trocar_status find_free(probe *p, const nodal_forces *loads, const double *attached, report *why) {
    vec3 *u = p->scratch->free_u;
    memset(u, 0, sizeof p->scratch->free_u);
    trocar_status status = nodal_displacement_add(p->beneath, loads, p->near_count, p->near, u, why);
    if (status == TROCAR_OK && attached) status = inverse_attached_displace(p->beneath, attached, p->near_count, p->near, u, why);
    return status;
}

/* ---- contact --------------------------------------------------------------------------------------------------------------------- */

/* Moves the near nodes to where the forces leave them. Returns the longest way, m. */
static double displace(probe *p) {
    probe_scratch *s = p->scratch;
    double longest = 0.0;
    for (int i = 0; i < p->near_count; i++) {
        vec3 u = s->free_u[i];
        for (int j = 0; j < p->near_count; j++)
            if (s->force[j] > 0.0) u = v3_add(u, yields(p, i, j, v3_scale(s->force[j], s->normal[j])));
        longest = fmax(longest, v3_norm(v3_sub(u, s->u[i])));
        s->u[i] = u;
    }
    return longest;
}

/* One step of a Newton iteration: gaps are linear in the displacement about the present one. The nodes' new displacement closes them where
   the force is not zero. */
static bool solve_linearised(probe *p, pose base) {
    probe_scratch *s = p->scratch;
    int count = 0;
    for (int i = 0; i < p->near_count; i++) {
        s->gap[i] = probe_gap(&p->shape, base, v3_add(mesh_of(p)->nodes[p->near[i]], s->u[i]), &s->normal[i]);
        if (s->gap[i] < REACH * p->shape.radius || s->force[i] > 0.0) s->chosen[count++] = i;
    }
    for (int a = 0; a < count; a++) {
        int i = s->chosen[a];
        s->z[a] = s->force[i];
        s->right[a] = s->gap[i] + v3_dot(s->normal[i], v3_sub(s->free_u[i], s->u[i]));
        for (int b = 0; b <= a; b++) {
            int j = s->chosen[b];
            s->matrix[a * MAX_PRESSED + b] = s->matrix[b * MAX_PRESSED + a] = v3_dot(s->normal[i], yields(p, i, j, s->normal[j]));
        }
    }
    if (!complementarity_solve(count, s->matrix, MAX_PRESSED, s->right, PENETRATION, s->z, s->pivoting)) return false;
    memset(s->force, 0, sizeof s->force);
    for (int a = 0; a < count; a++) s->force[s->chosen[a]] = s->z[a];
    return true;
}

/* From the forces of the last time. */
static void start_from_state(probe *p) {
    probe_scratch *s = p->scratch;
    memset(s->force, 0, sizeof s->force);
    for (int i = 0, k = 0; i < p->near_count && k < p->state.count; i++) {
        while (k < p->state.count && p->state.nodes[k].node < p->near[i]) k++;
        if (k == p->state.count || p->state.nodes[k].node != p->near[i]) continue;
        s->force[i] = p->state.nodes[k].force;
        s->normal[i] = p->state.nodes[k].normal;
    }
    displace(p);
}

static trocar_status solve_at(probe *p, pose base, const nodal_forces *loads, const double *attached, report *why) {
    trocar_status status = list_near(p, base, why);
    if (status == TROCAR_OK) status = find_compliance(p, why);
    if (status == TROCAR_OK) status = find_free(p, loads, attached, why);
    if (status != TROCAR_OK) return status;
    start_from_state(p);
    for (int k = 0; k < MOST_ITERATIONS; k++) {
        if (!solve_linearised(p, base)) return fail(why, TROCAR_NUMERIC, "the probe's contact has no solution");
        if (displace(p) < CONVERGED) break;
    }
    return TROCAR_OK;
}

/* ---- what is attached -------------------------------------------------------------------------------------------------------------- */

static trocar_status attach(probe *p, report *why) {
    attached_row rows[MAX_PRESSED];
    const mesh *m = mesh_of(p);
    int n = p->state.count;
    p->changes++;
    p->shifts++;
    for (int i = 0; i < n; i++) {
        const pressed_node *pressed = &p->state.nodes[i];
        const int *listed = bsearch(&pressed->node, p->surface, (size_t)p->surface_count, sizeof *p->surface, compare_nodes);
        rows[i] = (attached_row){.tet = p->surface_tet[listed - p->surface], .direction = pressed->row};
        for (int c = 0; c < 4; c++) rows[i].weights[c] = m->tets[rows[i].tet][c] == pressed->node;
    }
    attachment thing = {.id = ++p->last_attached, .row_count = n, .rows = rows, .compliance = p->scratch->zeros, .ld = n};
    return inverse_attach(p->inverse, n > 0, &thing, why);
}

static bool has_turned(const pressed_node *n) { return v3_norm(v3_cross(n->normal, n->row)) > TURNED; }

/* The solution into the state. True: what is attached must change. */
static bool take_solution(probe *p, pose base) {
    probe_scratch *s = p->scratch;
    probe_state *state = &p->state;
    int before = state->count, count = 0;
    bool changed = false;
    state->placed = true;
    state->base = base;
    state->wrench_force = state->wrench_torque = v3(0, 0, 0);
    static const pressed_node nothing = {.node = -1};
    pressed_node old[MAX_PRESSED];
    memcpy(old, state->nodes, (size_t)before * sizeof *old);
    for (int i = 0, k = 0; i < p->near_count; i++) {
        if (!(s->force[i] > 0.0)) continue;
        while (k < before && old[k].node < p->near[i]) k++;
        pressed_node *n = &state->nodes[count++];
        *n = k < before && old[k].node == p->near[i] ? old[k] : nothing;
        changed = changed || n->node < 0;
        n->node = p->near[i];
        n->normal = s->normal[i];
        n->force = s->force[i];
        changed = changed || has_turned(n);
        vec3 on_hand = v3_scale(-n->force, n->normal), at = v3_add(mesh_of(p)->nodes[n->node], s->u[i]);
        state->wrench_force = v3_add(state->wrench_force, on_hand);
        state->wrench_torque = v3_add(state->wrench_torque, v3_cross(v3_sub(at, base.position), on_hand));
    }
    state->count = count;
    changed = changed || count != before;
    for (int i = 0; i < count && changed; i++) state->nodes[i].row = state->nodes[i].normal;
    return changed;
}

static void tell(probe *p) {
    p->now.count = p->unloaded.count = p->state.count;
    for (int i = 0; i < p->state.count; i++) {
        const pressed_node *n = &p->state.nodes[i];
        p->scratch->nodes[i] = n->node;
        p->scratch->now[i] = v3_scale(n->force, n->normal);
        p->scratch->unloaded[i] = n->free_force;
    }
}

/* Subtracts from the forces the attached nodes' response to the held needles. */
static trocar_status find_free_forces(probe *p, const nodal_forces *loads, bool changed, report *why) {
    double *response = p->scratch->response, most = 0.0;
    trocar_status status = inverse_attached_response(p->inverse, loads, response, p->scratch->none, why);
    if (status != TROCAR_OK) return status;
    for (int i = 0; i < p->state.count; i++) {
        const pressed_node *n = &p->state.nodes[i];
        vec3 unloaded = v3_axpy(-response[i], n->row, v3_scale(n->force, n->normal));
        p->scratch->unloaded[i] = unloaded;
        most = fmax(most, v3_norm(v3_sub(unloaded, n->free_force)));
    }
    if (!changed && most < NOTICEABLE) return TROCAR_OK;
    p->shifts++;
    for (int i = 0; i < p->state.count; i++) p->state.nodes[i].free_force = p->scratch->unloaded[i];
    return TROCAR_OK;
}

/* ---- pressing ------------------------------------------------------------------------------------------------------------------------ */

static bool is_far(const probe *p, pose base) {
    for (int i = 0; i < p->surface_count; i++)
        if (gap_at_rest(p, base, p->surface[i]) < REACH * p->shape.radius) return false;
    return true;
}

static trocar_status press(probe *p, pose base, const other_loads *others, bool beneath_changed, report *why) {
    nodal_forces loads;
    if (beneath_changed) p->compliance_known = false;
    trocar_status status = collect_loads(p, others, &loads, why);
    int steps = p->state.placed ? 1 + (int)fmin(probe_way(&p->shape, p->state.base, base) / (STEP * p->shape.radius), MOST_STEPS) : 1;
    if (steps > MOST_STEPS) p->state.count = 0, steps = 1; /* put in anew; what is attached is found to have changed below */
    pose from = p->state.base;
    bool changed = beneath_changed || p->now.count != p->state.count;
    for (int i = 1; i <= steps && status == TROCAR_OK; i++) {
        pose at = i < steps ? pose_between(from, base, (double)i / steps) : base;
        if (p->state.count == 0 && is_far(p, at)) {
            p->state.placed = true;
            p->state.base = at;
            p->state.wrench_force = p->state.wrench_torque = v3(0, 0, 0);
            continue;
        }
        status = solve_at(p, at, &loads, others->attached, why);
        if (status == TROCAR_OK) changed = take_solution(p, at) || changed;
    }
    if (status == TROCAR_OK && changed) status = attach(p, why);
    return status == TROCAR_OK ? find_free_forces(p, &loads, changed, why) : status;
}

trocar_status probe_press(probe *p, pose base, const other_loads *others, bool beneath_changed, report *why) {
    trocar_status status = press(p, base, others, beneath_changed, why);
    if (status != TROCAR_OK) {
        report ignored;
        p->state.count = 0;
        p->state.wrench_force = p->state.wrench_torque = v3(0, 0, 0);
        p->compliance_known = false;
        attach(p, &ignored);
    }
    tell(p);
    return status;
}

trocar_status probe_resume(probe *p, const probe_state *state, report *why) {
    p->state = *state;
    p->compliance_known = false;
    p->near_count = 0;
    trocar_status status = attach(p, why);
    if (status != TROCAR_OK) p->state.count = 0;
    tell(p);
    return status;
}
