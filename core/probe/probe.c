#include "probe/probe.h"

#include <stdlib.h>
#include <string.h>

#include "linalg/complementarity.h"
#include "snapshot/free_displacement.h"

enum { LD = 3 * MAX_PRESSED };
enum { MOST_ITERATIONS = 50 }; /* iterations: maximum number of Newton iterations per solve. If it has not converged, the next solve continues where this one
                                  stopped. Cost limit */
enum { MOST_STOPS = 4 }; /* steps: maximum number of secant steps to find where the probe stops. The last one leaves the probe at its previous pose. Cost limit
                            */
static const double REACH = 0.5; /* probe radii: points this close are candidates for contact. Chosen: twice the probe's largest step */
static const double LOADED_REACH = 3.0; /* probe radii: points this close are candidates for contact if needles may push tissue toward the probe. Chosen: three
                                           times the largest displacement, 0.9 radii, in 200 random motions (verify_probe_motions) */
static const double BRIDGE = 1.0 - M_SQRT1_2; /* probe radii, below 1: how deep the midpoint of an edge may lie inside the probe, which is its depth if the ends
                                                 touch the probe 90 degrees apart. Past this depth, the edge no longer follows the wall around the probe, which
                                                 would slip through between the ends. Derived for that angle, which is chosen; force and field are within 1.8 %
                                                 of another program's (verify_probe) */
static const double LONG_EDGE = 0.5; /* probe radii: the midpoints of edges no longer than this are never pressed, because for its midpoint to reach the depth
                                        BRIDGE, such an edge would have to stretch to nearly three times its length. Derived for that depth */
static const double STEP = 0.25; /* probe radii: longest step of the probe; keeps the contact points from moving far on its surface. Chosen by judgement */
static const double CATCHING_UP = 0.3; /* m/s: speed at which a stopped probe catches up with the newest pose once the tissue yields. If it jumped there, it
                                          would jolt the hand. Chosen: as fast as a hand inserts a needle */
static const double CONVERGED = 1e-9; /* m: an iteration has converged if it moves no node further than this. Rounding tolerance */
static const double PENETRATION = 1e-12; /* m: a node that penetrates no deeper than this counts as outside. Rounding tolerance */
static const double TURNED = 0.02; /* rad: a point is attached again, along its new normal, once the normal has turned by this much. Cost limit */
static const double NOTICEABLE = 1e-5; /* N: new forces are published only if one of them has changed by at least this much. Cost limit */
static const double STOPPED = 1e-3; /* fraction of max_force: when the force limit stops the probe, the force may be this far below the limit. Chosen by
                                       judgement */
static const double EDGE_COMPLIANCE = 1e-4; /* fraction: how much of an edge's own compliance is added to its diagonal entry. Without it, the forces on an edge
                                               and on its two ends would be linearly dependent. Chosen by judgement */

typedef struct probe_scratch {
    vec3 free_u[MAX_PRESSED], u[MAX_PRESSED], load[MAX_PRESSED]; /* per near node: displacement (m) without and with the probe, and load (N) */
    vec3 normal[MAX_PRESSED];                                    /* outward normals of the candidates */
    double gap[MAX_PRESSED], force[MAX_PRESSED];                 /* gap (m) and force (N) of each candidate */
    int near_ends[MAX_PRESSED][2];                               /* indices in `near` of each candidate's ends; -1 if none */
    int chosen[MAX_PRESSED];                                     /* candidates included in the complementarity problem */
    double matrix[MAX_PRESSED * MAX_PRESSED], right[MAX_PRESSED], z[MAX_PRESSED], pivoting[MAX_PRESSED * (MAX_PRESSED + 2)];
    int nodes[2 * MAX_PRESSED];
    vec3 now[MAX_PRESSED], unloaded[MAX_PRESSED], pressed[MAX_PRESSED]; /* N, forces on `nodes`: now, without held needles, and at the needles' last ticks */
    vec3 point_force[MAX_PRESSED];                                      /* N, forces on the pressed points */
    unit_force unit[MAX_PRESSED];                                       /* unit forces on the chosen candidates */
    double response[MAX_PRESSED], none[1], attached[MAX_PRESSED * MAX_PRESSED];
    probe_state before;
} probe_scratch;

static const mesh *mesh_of(const probe *p) { return inverse_tissue(p->beneath)->mesh; }

/* ---- creation ------------------------------------------------------------------------------------------------------------- */

static int place_of(const probe *p, int node) {
    const int *listed = bsearch(&node, p->surface, (size_t)p->surface_count, sizeof *p->surface, compare_nodes);
    return listed ? (int)(listed - p->surface) : -1;
}

static int compare_edges(const void *a, const void *b) {
    const int *x = a, *y = b;
    return x[0] != y[0] ? compare_nodes(x, y) : compare_nodes(x + 1, y + 1);
}

/* Lists the surface's long edges, except those with both ends fixed. Each entry holds the two nodes in ascending order, and a tetrahedron with that edge.
   Returns NULL if out of memory. */
static int (*list_edges(const probe *p, int surface, int *count))[3] {
    const mesh *m = mesh_of(p);
    int most = 0;
    for (int t = 0; t < m->tet_count; t++)
        for (int face = 0; face < 4; face++) most += m->face_groups[t][face] >> surface & 1 ? 3 : 0;
    int (*edges)[3] = malloc((size_t)(most + 1) * sizeof *edges), found = 0;
    *count = 0;
    if (!edges) return NULL;
    for (int t = 0; t < m->tet_count; t++)
        for (int face = 0; face < 4; face++)
            for (int i = 0; i < 4 && m->face_groups[t][face] >> surface & 1; i++)
                for (int j = 0; j < i; j++) {
                    int a = m->tets[t][i], b = m->tets[t][j];
                    if (i == face || j == face || (place_of(p, a) < 0 && place_of(p, b) < 0)) continue;
                    if (v3_norm(v3_sub(m->nodes[a], m->nodes[b])) <= LONG_EDGE * p->shape.radius) continue;
                    memcpy(edges[found++], (int[3]){a < b ? a : b, a < b ? b : a, t}, sizeof *edges);
                }
    qsort(edges, (size_t)found, sizeof *edges, compare_edges);
    for (int i = 0; i < found; i++)
        if (i == 0 || compare_edges(edges[i], edges[*count - 1]) != 0) memmove(edges[(*count)++], edges[i], sizeof *edges);
    return edges;
}

static surface_point point_at(const probe *p, int tet, int a, int b) {
    const mesh *m = mesh_of(p);
    surface_point point = {.rest = m->nodes[a], .ends = {place_of(p, a), -1}, .weight = 1.0, .tet = tet};
    if (a != b) {
        point.rest = v3_scale(0.5, v3_add(m->nodes[a], m->nodes[b]));
        point.ends[1] = place_of(p, b);
        point.weight = 0.5;
        point.slack = BRIDGE * p->shape.radius;
    }
    for (int c = 0; c < 4; c++) point.weights[c] = m->tets[tet][c] == a || m->tets[tet][c] == b ? point.weight : 0.0;
    return point;
}

static trocar_status take_points(probe *p, int surface, trocar_error *why) {
    int edge_count, (*edges)[3] = list_edges(p, surface, &edge_count);
    p->points = malloc((size_t)(p->surface_count + edge_count + 1) * sizeof *p->points);
    if (edges && p->points) {
        p->point_count = p->surface_count;
        for (int t = 0; t < mesh_of(p)->tet_count; t++)
            for (int c = 0; c < 4; c++) {
                int node = mesh_of(p)->tets[t][c], place = place_of(p, node);
                if (place >= 0) p->points[place] = point_at(p, t, node, node);
            }
        for (int i = 0; i < edge_count; i++) p->points[p->point_count++] = point_at(p, edges[i][2], edges[i][0], edges[i][1]);
    }
    free(edges);
    return p->point_count > 0 ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for a probe");
}

static trocar_status take_surface(probe *p, int surface, trocar_error *why) {
    const mesh_group *group = &mesh_of(p)->groups[surface];
    const tissue *t = inverse_tissue(p->beneath);
    p->surface = malloc((size_t)(group->node_count + 1) * sizeof *p->surface);
    p->compliance = malloc((size_t)LD * LD * sizeof *p->compliance);
    p->scratch = calloc(1, sizeof *p->scratch);
    if (!p->surface || !p->compliance || !p->scratch) return fail(why, TROCAR_NO_MEMORY, "no memory for a probe");
    for (int i = 0; i < group->node_count; i++)
        if (t->dof[group->nodes[i]] >= 0) p->surface[p->surface_count++] = group->nodes[i];
    if (p->surface_count == 0) return fail(why, TROCAR_BAD_INPUT, "probe.surface: all nodes of \"%s\" are fixed", group->name);
    return take_points(p, surface, why);
}

trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, double max_force, probe **created, trocar_error *why) {
    probe *p = *created = calloc(1, sizeof *p);
    if (!p) return fail(why, TROCAR_NO_MEMORY, "no memory for a probe");
    p->shape = *shape;
    p->max_force = max_force;
    p->beneath = beneath;
    p->support = (support){.tissue = beneath, .most = MAX_PRESSED};
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
    free(p->points);
    free(p->compliance);
    free(p->scratch);
    support_free(&p->support);
    free(p);
}

/* ---- nodes that can take part ------------------------------------------------------------------------------------------------ */

static double gap_at_rest(const probe *p, pose base, int point) {
    vec3 ignored;
    return probe_gap(&p->shape, base, p->points[point].rest, &ignored) + p->points[point].slack;
}

static int find(int number, int count, const int *ascending) {
    const int *found = bsearch(&number, ascending, (size_t)count, sizeof *ascending, compare_nodes);
    return found ? (int)(found - ascending) : -1;
}

static int compare_gaps(const void *a, const void *b) {
    const double *x = a, *y = b;
    return x[0] < y[0] ? -1 : x[0] > y[0] ? 1 : (x[1] > y[1]) - (x[1] < y[1]);
}

/* Chooses the candidates: first the pressed points, then the other points by increasing distance, until there is no room left for points or for their ends. */
static void choose_closest(probe *p, double (*gaps)[2]) {
    int before[MAX_PRESSED], near_before = p->near_count;
    memcpy(before, p->near, sizeof before);
    p->near_count = p->candidate_count = 0;
    for (int i = 0; i < p->point_count && p->candidate_count < MAX_PRESSED; i++) {
        const surface_point *point = &p->points[(int)gaps[i][1]];
        int missing[2], count = 0;
        for (int e = 0; e < 2; e++) {
            bool listed = point->ends[e] < 0;
            for (int k = 0; k < p->near_count && !listed; k++) listed = p->near[k] == p->surface[point->ends[e]];
            if (!listed) missing[count++] = p->surface[point->ends[e]];
        }
        if (p->near_count + count > MAX_PRESSED) continue;
        for (int k = 0; k < count; k++) p->near[p->near_count++] = missing[k];
        p->candidates[p->candidate_count++] = (int)gaps[i][1];
    }
    qsort(p->near, (size_t)p->near_count, sizeof *p->near, compare_nodes);
    qsort(p->candidates, (size_t)p->candidate_count, sizeof *p->candidates, compare_nodes);
    if (p->near_count != near_before || memcmp(before, p->near, (size_t)near_before * sizeof *before) != 0) p->compliance_known = false;
    for (int i = 0; i < p->candidate_count; i++)
        for (int e = 0; e < 2; e++) {
            int end = p->points[p->candidates[i]].ends[e];
            p->scratch->near_ends[i][e] = end < 0 ? -1 : find(p->surface[end], p->near_count, p->near);
        }
}

/* Returns whether the probe might touch this point, considering that other loads may push the tissue toward it. */
static bool in_reach(const probe *p, pose base, int point, const double *attached) {
    double reach = p->support.node_count > 0 || attached ? LOADED_REACH : REACH;
    return gap_at_rest(p, base, point) < reach * p->shape.radius;
}

/* Returns whether all points are out of the probe's reach. */
static bool is_far(const probe *p, pose base, const double *attached) {
    for (int i = 0; i < p->point_count; i++)
        if (in_reach(p, base, i, attached)) return false;
    return true;
}

/* Chooses the candidates anew, unless every point that the probe might touch is already one of them. */
static trocar_status list_near(probe *p, pose base, const double *attached, trocar_error *why) {
    bool listed = p->near_count > 0;
    for (int i = 0; i < p->point_count && listed; i++) listed = !in_reach(p, base, i, attached) || find(i, p->candidate_count, p->candidates) >= 0;
    for (int i = 0; i < p->state.count && listed; i++) listed = find(p->state.points[i].point, p->candidate_count, p->candidates) >= 0;
    if (listed) return TROCAR_OK;
    double (*gaps)[2] = malloc((size_t)p->point_count * sizeof *gaps); /* each point's gap, and its index */
    if (!gaps) return fail(why, TROCAR_NO_MEMORY, "no memory for the probe's contacts");
    for (int i = 0; i < p->point_count; i++) gaps[i][0] = gap_at_rest(p, base, i), gaps[i][1] = i;
    for (int i = 0; i < p->state.count; i++) gaps[p->state.points[i].point][0] = -INFINITY;
    qsort(gaps, (size_t)p->point_count, sizeof *gaps, compare_gaps);
    choose_closest(p, gaps);
    free(gaps);
    return TROCAR_OK;
}

static trocar_status find_compliance(probe *p, trocar_error *why) {
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

/* Interpolates a field from the near nodes to a candidate. The field is 0 at fixed ends. */
static vec3 at_candidate(const probe *p, int candidate, const vec3 *field) {
    const int *ends = p->scratch->near_ends[candidate];
    vec3 sum = v3(0, 0, 0);
    for (int e = 0; e < 2; e++)
        if (ends[e] >= 0) sum = v3_axpy(p->points[p->candidates[candidate]].weight, field[ends[e]], sum);
    return sum;
}

static vec3 candidate_yields(const probe *p, int i, int j, vec3 force) {
    const int *to = p->scratch->near_ends[i], *from = p->scratch->near_ends[j];
    double weight = p->points[p->candidates[i]].weight * p->points[p->candidates[j]].weight;
    vec3 sum = v3(0, 0, 0);
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++)
            if (to[a] >= 0 && from[b] >= 0) sum = v3_axpy(weight, yields(p, to[a], from[b], force), sum);
    return sum;
}

/* Returns the compliance (m/N) of candidate i along its normal that comes on top of its nodes' compliance. 0 for a node. */
static double own_compliance(const probe *p, int i) {
    if (p->points[p->candidates[i]].weight == 1.0) return 0.0;
    vec3 normal = p->scratch->normal[i];
    return EDGE_COMPLIANCE * v3_dot(normal, candidate_yields(p, i, i, normal));
}

/* Computes how far the near nodes would be displaced without the probe. */
static trocar_status find_free(probe *p, const double *attached, trocar_error *why) {
    vec3 *u = p->scratch->free_u;
    memset(u, 0, sizeof p->scratch->free_u);
    trocar_status status = support_reach(&p->support, p->near_count, p->near, u, why);
    if (status == TROCAR_OK && attached) status = inverse_attached_displace(p->beneath, attached, p->near_count, p->near, u, why);
    return status;
}

/* ---- contact --------------------------------------------------------------------------------------------------------------------- */

/* Updates the displacements of the near nodes from the contact forces. Returns how far the node that moved most has moved (m). */
static double displace(probe *p) {
    probe_scratch *s = p->scratch;
    double longest = 0.0;
    memset(s->load, 0, sizeof s->load);
    for (int i = 0; i < p->candidate_count; i++)
        for (int e = 0; e < 2 && s->force[i] > 0.0; e++) {
            int end = s->near_ends[i][e];
            if (end >= 0) s->load[end] = v3_axpy(p->points[p->candidates[i]].weight * s->force[i], s->normal[i], s->load[end]);
        }
    vec3 before[MAX_PRESSED];
    memcpy(before, s->u, (size_t)p->near_count * sizeof *before);
    for (int i = 0; i < p->near_count; i++) {
        s->u[i] = s->free_u[i];
        for (int j = 0; j < p->near_count; j++)
            if (v3_dot(s->load[j], s->load[j]) > 0.0) s->u[i] = v3_add(s->u[i], yields(p, i, j, s->load[j]));
    }
    support_displace(&p->support, s->load, s->u);
    for (int i = 0; i < p->near_count; i++) longest = fmax(longest, v3_norm(v3_sub(s->u[i], before[i])));
    return longest;
}

static vec3 displaced(const probe *p, int candidate) {
    return v3_add(p->points[p->candidates[candidate]].rest, at_candidate(p, candidate, p->scratch->u));
}

/* Does one Newton step: linearises the gaps about the current displacement, then solves for forces that close each gap with a nonzero force. Returns false if
   there is no solution. */
static bool solve_linearised(probe *p, pose base) {
    probe_scratch *s = p->scratch;
    int count = 0;
    for (int i = 0; i < p->candidate_count; i++) {
        s->gap[i] = probe_gap(&p->shape, base, displaced(p, i), &s->normal[i]) + p->points[p->candidates[i]].slack;
        if (s->gap[i] < REACH * p->shape.radius || s->force[i] > 0.0) s->chosen[count++] = i;
    }
    for (int a = 0; a < count; a++) {
        int i = s->chosen[a];
        s->z[a] = s->force[i];
        s->right[a] = s->gap[i] + v3_dot(s->normal[i], v3_sub(at_candidate(p, i, s->free_u), at_candidate(p, i, s->u)));
        for (int b = 0; b <= a; b++) {
            int j = s->chosen[b];
            s->matrix[a * MAX_PRESSED + b] = s->matrix[b * MAX_PRESSED + a] = v3_dot(s->normal[i], candidate_yields(p, i, j, s->normal[j]));
        }
        s->matrix[a * MAX_PRESSED + a] += own_compliance(p, i);
        s->unit[a] = (unit_force){{s->near_ends[i][0], s->near_ends[i][1]}, v3_scale(p->points[p->candidates[i]].weight, s->normal[i])};
    }
    support_stiffen(&p->support, count, s->unit, s->matrix, MAX_PRESSED);
    if (!complementarity_solve(count, s->matrix, MAX_PRESSED, s->right, PENETRATION, s->z, s->pivoting)) return false;
    memset(s->force, 0, sizeof s->force);
    for (int a = 0; a < count; a++) s->force[s->chosen[a]] = s->z[a];
    return true;
}

/* Takes the forces of the last solution as the initial guess. */
static void start_from_state(probe *p) {
    probe_scratch *s = p->scratch;
    memset(s->force, 0, sizeof s->force);
    for (int k = 0; k < p->state.count; k++) {
        int i = find(p->state.points[k].point, p->candidate_count, p->candidates);
        if (i < 0) continue;
        s->force[i] = p->state.points[k].force;
        s->normal[i] = p->state.points[k].normal;
    }
    displace(p);
}

static trocar_status solve_at(probe *p, pose base, const double *attached, trocar_error *why) {
    trocar_status status = list_near(p, base, attached, why);
    if (status == TROCAR_OK) status = find_compliance(p, why);
    if (status == TROCAR_OK) status = find_free(p, attached, why);
    if (status != TROCAR_OK) return status;
    start_from_state(p);
    for (int k = 0; k < MOST_ITERATIONS; k++) {
        if (!solve_linearised(p, base)) return fail(why, TROCAR_NUMERIC, "the probe's contact has no solution");
        if (displace(p) < CONVERGED) break;
    }
    return TROCAR_OK;
}

/* ---- what is attached -------------------------------------------------------------------------------------------------------------- */

static trocar_status attach(probe *p, trocar_error *why) {
    attached_row rows[MAX_PRESSED];
    int n = p->state.count;
    double *own = p->scratch->attached;
    p->changes++;
    p->shifts++;
    memset(own, 0, (size_t)n * (size_t)n * sizeof *own);
    for (int i = 0; i < n; i++) {
        const pressed_point *pressed = &p->state.points[i];
        const surface_point *point = &p->points[pressed->point];
        rows[i] = (attached_row){.tet = point->tet, .direction = pressed->row};
        memcpy(rows[i].weights, point->weights, sizeof rows[i].weights);
        own[i * n + i] = pressed->own_compliance;
    }
    attachment thing = {.id = ++p->last_attached, .row_count = n, .rows = rows, .compliance = own, .ld = n};
    p->attached_count = n;
    return inverse_attach(p->inverse, n > 0, &thing, why);
}

static bool has_turned(const pressed_point *n) { return v3_norm(v3_cross(n->normal, n->row)) > TURNED; }

/* Computes the force on the hand and its torque about the base. */
static vec3 wrench_of_solution(const probe *p, pose base, vec3 *torque) {
    const probe_scratch *s = p->scratch;
    vec3 force = *torque = v3(0, 0, 0);
    for (int i = 0; i < p->candidate_count; i++) {
        if (!(s->force[i] > 0.0)) continue;
        vec3 on_hand = v3_scale(-s->force[i], s->normal[i]);
        force = v3_add(force, on_hand);
        *torque = v3_add(*torque, v3_cross(v3_sub(displaced(p, i), base.position), on_hand));
    }
    return force;
}

/* Stores the solution in the state. Returns true if the points must be attached again. */
static bool take_solution(probe *p, pose base) {
    probe_scratch *s = p->scratch;
    probe_state *state = &p->state;
    int before = state->count, count = 0;
    bool changed = false;
    state->placed = true;
    state->base = base;
    state->wrench_force = wrench_of_solution(p, base, &state->wrench_torque);
    static const pressed_point nothing = {.point = -1};
    pressed_point old[MAX_PRESSED];
    memcpy(old, state->points, (size_t)before * sizeof *old);
    for (int i = 0, k = 0; i < p->candidate_count; i++) {
        if (!(s->force[i] > 0.0)) continue;
        while (k < before && old[k].point < p->candidates[i]) k++;
        pressed_point *n = &state->points[count++];
        *n = k < before && old[k].point == p->candidates[i] ? old[k] : nothing;
        changed = changed || n->point < 0;
        n->point = p->candidates[i];
        n->normal = s->normal[i];
        n->force = s->force[i];
        n->own_compliance = own_compliance(p, i);
        changed = changed || has_turned(n);
    }
    state->count = count;
    changed = changed || count != before;
    for (int i = 0; i < count && changed; i++) state->points[i].row = state->points[i].normal;
    return changed;
}

/* Distributes forces on the pressed points to the nodes in `now`. */
static void distribute(const probe *p, const vec3 *point_force, vec3 *nodal) {
    memset(nodal, 0, MAX_PRESSED * sizeof *nodal);
    for (int i = 0; i < p->state.count; i++) {
        const surface_point *point = &p->points[p->state.points[i].point];
        for (int e = 0; e < 2; e++) {
            if (point->ends[e] < 0) continue;
            int at = find(p->surface[point->ends[e]], p->now.count, p->now.nodes);
            nodal[at] = v3_axpy(point->weight, point_force[i], nodal[at]);
        }
    }
}

/* Lists the nodes of the pressed points, without duplicates, and their forces. */
static void publish(probe *p) {
    probe_scratch *s = p->scratch;
    int count = 0;
    for (int i = 0; i < p->state.count; i++) {
        const surface_point *point = &p->points[p->state.points[i].point];
        for (int e = 0; e < 2; e++)
            if (point->ends[e] >= 0) s->nodes[count++] = p->surface[point->ends[e]];
    }
    qsort(s->nodes, (size_t)count, sizeof *s->nodes, compare_nodes);
    int distinct = 0;
    for (int i = 0; i < count; i++)
        if (distinct == 0 || s->nodes[distinct - 1] != s->nodes[i]) s->nodes[distinct++] = s->nodes[i];
    p->now.count = p->unloaded.count = distinct;
    for (int i = 0; i < p->state.count; i++) s->point_force[i] = v3_scale(p->state.points[i].force, p->state.points[i].normal);
    distribute(p, s->point_force, s->now);
    for (int i = 0; i < p->state.count; i++) s->point_force[i] = p->state.points[i].free_force;
    distribute(p, s->point_force, s->unloaded);
}

/* Computes the free forces: the current forces minus the part that is a response to held needles. */
static trocar_status find_free_forces(probe *p, bool changed, trocar_error *why) {
    double *response = p->scratch->response, most = 0.0;
    vec3 *unloaded = p->scratch->point_force;
    nodal_forces loads = support_forces(&p->support, p->scratch->load);
    trocar_status status = inverse_attached_response(p->inverse, &loads, response, p->scratch->none, why);
    if (status != TROCAR_OK) return status;
    for (int i = 0; i < p->state.count; i++) {
        const pressed_point *n = &p->state.points[i];
        unloaded[i] = v3_axpy(-response[i], n->row, v3_scale(n->force, n->normal));
        most = fmax(most, v3_norm(v3_sub(unloaded[i], n->free_force)));
    }
    if (!changed && most < NOTICEABLE) return TROCAR_OK;
    p->shifts++;
    for (int i = 0; i < p->state.count; i++) p->state.points[i].free_force = unloaded[i];
    return TROCAR_OK;
}

/* Prepares the response of the needles to the probe. At the needles' last ticks, the pressed points were attached, so the force on each was its free force plus
   its response to the needles. */
static trocar_status prepare_support(probe *p, const needle_holds *holds, bool stale, trocar_error *why) {
    probe_scratch *s = p->scratch;
    const nodal_forces loads = {p->support.node_count, p->support.nodes, p->support.force};
    if (loads.count == 0) return TROCAR_OK;
    trocar_status status = stale ? TROCAR_OK : inverse_attached_response(p->inverse, &loads, s->response, s->none, why);
    for (int i = 0; i < p->state.count; i++) {
        const pressed_point *n = &p->state.points[i];
        s->point_force[i] = stale ? v3_scale(n->force, n->normal) : v3_axpy(s->response[i], n->row, n->free_force);
    }
    distribute(p, s->point_force, s->pressed);
    return status == TROCAR_OK ? support_prepare(&p->support, holds, &(nodal_forces){p->now.count, p->now.nodes, s->pressed}, why) : status;
}

/* ---- pressing ------------------------------------------------------------------------------------------------------------------------ */

bool probe_axis_in_tissue(const mesh *m, const probe_shape *shape, pose base) {
    vec3 tip = v3_add(base.position, q_rotate(base.orientation, v3(0, 0, shape->length - shape->tip_radius)));
    return mesh_locate(m, tip, -1) >= 0 || mesh_locate(m, base.position, -1) >= 0 || mesh_enter(m, base.position, tip).hit;
}

static trocar_status solve_force(probe *p, pose at, const double *attached, double *force, trocar_error *why) {
    vec3 ignored;
    trocar_status status = solve_at(p, at, attached, why);
    *force = status == TROCAR_OK ? v3_norm(wrench_of_solution(p, at, &ignored)) : 0.0;
    return status;
}

/* Finds a pose between the current one and `to` at which the force is just below the limit, by the secant method. `beyond`: the force at `to`. Leaves the
   solution for that pose in the scratch memory. */
static trocar_status solve_short_of(probe *p, pose *to, double beyond, const double *attached, trocar_error *why) {
    pose from = p->state.base, end = *to;
    double force = v3_norm(p->state.wrench_force), part = 1.0, target = (1.0 - STOPPED) * p->max_force;
    for (int i = 0; i < MOST_STOPS; i++) {
        part = i + 1 < MOST_STOPS ? part * fmax(0.0, (target - force) / (beyond - force)) : 0.0;
        *to = part > 0.0 ? pose_between(from, end, part) : from;
        trocar_status status = solve_force(p, *to, attached, &beyond, why);
        if (status != TROCAR_OK || part == 0.0 || beyond <= p->max_force) return status;
    }
    return TROCAR_OK;
}

/* Moves the probe to the next pose on its path. Sets `free` to false if the tissue stops it before it gets there. */
static trocar_status press_at(probe *p, pose at, const double *attached, bool *free, bool *changed, trocar_error *why) {
    double force;
    if (p->state.count == 0 && is_far(p, at, attached)) {
        p->state.placed = true;
        p->state.base = at;
        p->state.wrench_force = p->state.wrench_torque = v3(0, 0, 0);
        return TROCAR_OK;
    }
    trocar_status status = solve_force(p, at, attached, &force, why);
    *free = force <= fmax(p->max_force, v3_norm(p->state.wrench_force));
    if (status == TROCAR_OK && !*free) status = solve_short_of(p, &at, force, attached, why);
    if (status == TROCAR_OK) *changed = take_solution(p, at) || *changed;
    return status;
}

/* Puts the probe at a pose directly, without intermediate steps. If that would push its axis into the undeformed tissue or exceed the force limit, the probe
   stays where it was. */
static trocar_status put_in(probe *p, pose base, const double *attached, bool *free, bool *changed, trocar_error *why) {
    double force = 0.0;
    trocar_status status = TROCAR_OK;
    p->scratch->before = p->state;
    p->state.count = 0;
    *free = !probe_axis_in_tissue(mesh_of(p), &p->shape, base);
    if (*free && !is_far(p, base, attached)) status = solve_force(p, base, attached, &force, why);
    if (status == TROCAR_OK && *free && force <= p->max_force) {
        *changed = p->scratch->before.count > 0;
        return press_at(p, base, attached, free, changed, why);
    }
    p->state = p->scratch->before;
    if (status == TROCAR_OK && p->state.placed) status = press_at(p, p->state.base, attached, free, changed, why);
    *free = false;
    return status;
}

/* Returns how many steps it takes to move this far (m), or MOST_STEPS + 1 if there would be too many. */
static int steps_of(const probe *p, double way) { return 1 + (int)fmin(way / (STEP * p->shape.radius), MOST_STEPS); }

static trocar_status press(probe *p, pose base, double elapsed, const other_loads *others, const needle_holds *holds, bool beneath_changed, trocar_error *why) {
    const double *attached = others->attached;
    bool changed = beneath_changed || p->attached_count != p->state.count, free = true;
    if (beneath_changed) p->compliance_known = false;
    trocar_status status = support_list(&p->support, others, holds, why);
    if (status == TROCAR_OK) status = prepare_support(p, holds, changed, why);
    if (status != TROCAR_OK) return status;
    pose from = p->state.base;
    double way = probe_way(&p->shape, from, base), reach = p->state.stopped ? CATCHING_UP * elapsed : INFINITY;
    bool direct = !p->state.placed || steps_of(p, way) > MOST_STEPS, catches_up = !direct && way > reach;
    if (catches_up) base = pose_between(from, base, reach / way);
    int steps = steps_of(p, fmin(way, reach));
    if (direct) status = put_in(p, base, attached, &free, &changed, why);
    else
        for (int i = 1; i <= steps && status == TROCAR_OK && free; i++)
            status = press_at(p, i < steps ? pose_between(from, base, (double)i / steps) : base, attached, &free, &changed, why);
    p->state.stopped = (!free && (direct || way > 0.0)) || catches_up; /* a probe that has reached its pose is not considered stopped just because a needle
                                                                          raises the force on it */
    if (status == TROCAR_OK && changed) status = attach(p, why);
    return status == TROCAR_OK ? find_free_forces(p, changed, why) : status;
}

trocar_status probe_press(probe *p, pose base, double elapsed, const other_loads *others, const needle_holds *holds, bool beneath_changed, trocar_error *why) {
    trocar_status status = press(p, base, elapsed, others, holds, beneath_changed, why);
    if (status != TROCAR_OK) {
        trocar_error ignored;
        p->state.count = 0;
        p->state.wrench_force = p->state.wrench_torque = v3(0, 0, 0);
        p->compliance_known = false;
        attach(p, &ignored);
    }
    publish(p);
    return status;
}

trocar_status probe_resume(probe *p, const probe_state *state, trocar_error *why) {
    p->state = *state;
    p->compliance_known = false;
    p->near_count = 0;
    trocar_status status = attach(p, why);
    if (status != TROCAR_OK) p->state.count = 0;
    publish(p);
    return status;
}
