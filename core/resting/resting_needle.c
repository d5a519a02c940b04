#include "resting/resting_needle.h"

#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "insertion/guide/guides.h"
#include "insertion/laws/creep.h"
#include "insertion/laws/stiffening.h"
#include "insertion/step/equilibrium.h"
#include "insertion/step/tick.h"

static const double STEP_SHIFT = 0.3e-3; /* m: how far the base may shift per 1 ms step while a released needle moves to its resting position. Chosen: 0.3 m/s,
                                            as fast as a hand inserts */
static const double STEP_TURN = 3e-3; /* rad: how far the base may turn per 1 ms step while a released needle moves to its resting position. Chosen by judgement
                                         */
static const double DEPENDENT = 1e-6; /* fraction: a motion counts as linearly dependent on the others if its relative distance from their span is below this.
                                         Rounding tolerance */

/* ---- linearising ---------------------------------------------------------------------------------------------------------- */

static vec3 direction_of(const resting_needle *r, int u) {
    return m3_column(&r->points[point_of_unknown(r->point_count, u)].at.frame, axis_of_unknown(r->point_count, u));
}

/* Returns the element of the nominal mesh on which the point's force acts, and the point's barycentric weights in it. -1 if the force does not act on the mesh.
   */
static int element_of(const mesh *m, const insertion_state *state, const contact_point *p, double weights[4]) {
    if (p->kind == POINT_GUIDE) return -1;
    if (p->kind == POINT_TIP) {
        memcpy(weights, state->tip.known.weights, 4 * sizeof *weights);
        return state->tip.known.tet;
    }
    const added_node *node = &state->refined.nodes[p->handle];
    mesh_barycentric(m, node->tet, node->position, weights);
    return node->tet;
}

static void take_rows(const mesh *m, const insertion_state *state, resting_needle *r) {
    for (int u = 0; u < r->unknown_count; u++) {
        attached_row *row = &r->rows[u];
        row->tet = element_of(m, state, &r->points[point_of_unknown(r->point_count, u)], row->weights);
        row->direction = direction_of(r, u);
    }
}

static void take_places(const insertion_model *model, const insertion_state *state, resting_needle *r) {
    insertion_place_loads(model, state, &r->places);
    shaft_steps_lay(model->mesh, &r->places, 0.0, model->settings.contact_spacing, &r->steps);
}

int resting_place(const resting_needle *r, int u) {
    int guided = 0;
    while (guided < r->point_count && r->points[guided].kind == POINT_GUIDE) guided++;
    int place = point_of_unknown(r->point_count, u) - guided;
    return place >= 0 && place < r->places.count && r->rows[u].tet >= 0 ? place : -1;
}

/* Returns what fraction of the piece of shaft at this place lies on step k of the track. */
static double part_on_step(const resting_needle *r, int place, int k) {
    const shaft_piece *piece = &r->places.loads[place].shaft;
    double from = r->steps.start + k * r->steps.step;
    return fmax(0.0, fmin(piece->to, from + r->steps.step) - fmax(piece->from, from)) / (piece->to - piece->from);
}

trocar_status resting_lacks(needle_pairs *pairs, const resting_needle *r, const shaft_piece *piece, mat3 *lacks, bool *any, trocar_error *why) {
    mat3 on_step[SHIFT_STEPS];
    int from, to;
    trocar_status status = needle_pairs_find(pairs, &r->steps, piece, &from, &to, on_step, why);
    *any = status == TROCAR_OK && to > from;
    for (int i = 0; i < r->places.count && *any; i++) {
        lacks[i] = (mat3){{{0}}};
        for (int k = from; k < to; k++) m3_add_scaled(&lacks[i], part_on_step(r, i, k), &on_step[k]);
    }
    return status;
}

/* Adds half of the displacement per unit force of the other needle that the mesh does not resolve, as blocks of a matrix: rows for this needle's places,
   columns for the other's, or the reverse if `transposed`. */
static trocar_status add_lacks(needle_pairs *pairs, const resting_needle *r, const resting_needle *other, bool transposed, mat3 *blocks, int ld,
                               trocar_error *why) {
    mat3 lacks[MAX_LOADS];
    for (int j = 0; j < other->places.count; j++) {
        bool any;
        trocar_status status = resting_lacks(pairs, r, &other->places.loads[j].shaft, lacks, &any, why);
        if (status != TROCAR_OK) return status;
        for (int i = 0; i < r->places.count && any; i++) {
            mat3 block = transposed ? m3_transposed(&lacks[i]) : lacks[i];
            m3_add_scaled(&blocks[transposed ? j * ld + i : i * ld + j], 0.5, &block);
        }
    }
    return TROCAR_OK;
}

trocar_status resting_mutual(needle_pairs *pairs, const resting_needle *r, const resting_needle *other, double *compliance, int ld, trocar_error *why) {
    int count = other->places.count;
    mat3 *blocks = calloc((size_t)r->places.count * (size_t)count + 1, sizeof *blocks);
    if (!blocks) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    trocar_status status = add_lacks(pairs, r, other, false, blocks, count, why);
    if (status == TROCAR_OK) status = add_lacks(pairs, other, r, true, blocks, count, why);
    for (int u = 0; u < r->unknown_count; u++)
        for (int v = 0, i = resting_place(r, u); v < other->unknown_count; v++) {
            int j = resting_place(other, v);
            compliance[u * ld + v] = i < 0 || j < 0 ? 0.0 : v3_dot(r->rows[u].direction, m3_apply(&blocks[i * count + j], other->rows[v].direction));
        }
    free(blocks);
    return status;
}

/* Interpolates the nominal mesh's compliance between the needle's points. `blocks`: square, 3 point_count rows. */
static trocar_status interpolated(const mesh *m, const insertion_state *state, inverse *inv, const resting_needle *r, double *blocks, trocar_error *why) {
    int count = 0, nodes[4 * MAX_POINTS], place[MAX_POINTS][4], ld = 3 * r->point_count;
    double weights[MAX_POINTS][4];
    for (int i = 0; i < r->point_count; i++) {
        int tet = element_of(m, state, &r->points[i], weights[i]);
        for (int c = 0; c < 4; c++) {
            place[i][c] = -1;
            if (tet < 0) continue;
            int k = 0;
            while (k < count && nodes[k] != m->tets[tet][c]) k++;
            if (k == count) nodes[count++] = m->tets[tet][c];
            place[i][c] = k;
        }
    }
    double *found = malloc(9 * (size_t)(count + 1) * (size_t)count * sizeof *found);
    if (!found) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    trocar_status status = inverse_gather(inv, &(inverse_blocks){count, nodes, count, nodes, found, 3 * count}, why);
    for (int i = 0; i < r->point_count && status == TROCAR_OK; i++)
        for (int j = 0; j < r->point_count; j++) {
            mat3 sum = {{{0}}};
            for (int c = 0; c < 16; c++)
                if (place[i][c / 4] >= 0 && place[j][c % 4] >= 0)
                    m3_add_block(&sum, weights[i][c / 4] * weights[j][c % 4], found + (size_t)(9 * place[i][c / 4] * count) + 3 * place[j][c % 4], 3 * count);
            for (int a = 0; a < 9; a++) blocks[(3 * i + a / 3) * ld + 3 * j + a % 3] = sum.m[a / 3][a % 3];
        }
    free(found);
    return status;
}

/* Copies the compliance of the assembled contact problem, minus what the nominal mesh contributes. In the tip's rows, this removes all of the tissue's
   contribution. */
static trocar_status take_compliance(const mesh *m, const insertion_state *state, const insertion_workspace *w, inverse *inv, resting_needle *r,
                                     trocar_error *why) {
    const contact_problem *p = &w->problem;
    int ld = 3 * r->point_count;
    double *blocks = malloc((size_t)ld * (size_t)ld * sizeof *blocks), yield = w->creep.yield;
    if (!blocks) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    trocar_status status = interpolated(m, state, inv, r, blocks, why);
    for (int u = 0; u < r->unknown_count && status == TROCAR_OK; u++)
        for (int v = 0; v <= u; v++) {
            mat3 block = {{{0}}};
            m3_add_block(&block, 1.0, blocks + 3 * point_of_unknown(r->point_count, u) * ld + 3 * point_of_unknown(r->point_count, v), ld);
            r->compliance[u][v] = p->compliance[v][u] - yield * v3_dot(direction_of(r, u), m3_apply(&block, direction_of(r, v)));
        }
    free(blocks);
    return status;
}

/* Decouples a row, so that no load produces a force in it. */
static void uncouple(resting_needle *r, int u) {
    for (int v = 0; v < u; v++) r->compliance[u][v] = 0.0;
    for (int v = u + 1; v < r->unknown_count; v++) r->compliance[v][u] = 0.0;
    r->compliance[u][u] = 1.0;
    r->rows[u].tet = -1;
    r->offset[u] = 0.0;
    for (int k = 0; k < r->motion_count; k++) r->motions[k][u] = 0.0;
}

static bool is_open(const insertion_workspace *w, const resting_needle *r, int u) {
    if (guides_is_open(&w->points, w->edges, point_of_unknown(r->point_count, u))) return true;
    int axial = u - 2 * r->point_count;
    return axial >= 0 && r->upper[axial] <= 0.0 && r->lower[axial] >= 0.0;
}

/* Sets r->offset to the offsets of the linearised stiffening laws. Overwrites the problem's gaps. */
static void take_offset(const insertion_state *state, insertion_workspace *w, resting_needle *r) {
    memset(w->problem.gap, 0, sizeof w->problem.gap);
    stiffening_shift_gaps(state, &w->points, &w->tissue, &w->stiffening, &w->problem);
    for (int u = 0; u < r->unknown_count; u++) r->offset[u] = -w->problem.gap[u];
}

/* Copies the compliance and the offsets, then decouples the rows whose forces stay zero. */
static trocar_status take_coupled(const mesh *m, const insertion_state *state, insertion_workspace *w, inverse *inv, resting_needle *r, trocar_error *why) {
    trocar_status status = take_compliance(m, state, w, inv, r, why);
    take_offset(state, w, r);
    for (int u = 0; u < r->unknown_count && status == TROCAR_OK; u++)
        if (is_open(w, r, u)) uncouple(r, u);
    return status;
}

static vec3 displaced(base_motion t, vec3 lever) { return v3_add(t.shift, v3_cross(t.turn, lever)); }

/* Computes orthonormal motions of the rows, along with the base motions that cause them. Rotations are scaled by the arc that the tip traces. */
static void take_motions(const insertion_workspace *w, pose base, double length, resting_needle *r) {
    vec3 x = q_rotate(base.orientation, v3(1.0 / length, 0, 0)), y = q_rotate(base.orientation, v3(0, 1.0 / length, 0));
    const base_motion given[MAX_MOTIONS] = {{.shift = {1, 0, 0}}, {.shift = {0, 1, 0}}, {.shift = {0, 0, 1}}, {.turn = x}, {.turn = y}};
    r->motion_count = 0;
    for (int g = 0; g < MAX_MOTIONS; g++) {
        double *rows = r->motions[r->motion_count], size = 0.0, left = 0.0;
        base_motion t = given[g];
        for (int u = 0; u < r->unknown_count; u++) {
            vec3 lever = v3_sub(r->points[point_of_unknown(r->point_count, u)].at.position, base.position);
            rows[u] = is_open(w, r, u) ? 0.0 : v3_dot(direction_of(r, u), displaced(t, lever));
            size += rows[u] * rows[u];
        }
        for (int round = 0; round < 2; round++)
            for (int k = 0; k < r->motion_count; k++) {
                double share = 0.0;
                for (int u = 0; u < r->unknown_count; u++) share += r->motions[k][u] * rows[u];
                for (int u = 0; u < r->unknown_count; u++) rows[u] -= share * r->motions[k][u];
                t = (base_motion){v3_axpy(-share, r->twists[k].shift, t.shift), v3_axpy(-share, r->twists[k].turn, t.turn)};
            }
        for (int u = 0; u < r->unknown_count; u++) left += rows[u] * rows[u];
        if (!(left > DEPENDENT * DEPENDENT * size) || size == 0.0) continue;
        for (int u = 0; u < r->unknown_count; u++) rows[u] /= sqrt(left);
        r->twists[r->motion_count++] = (base_motion){v3_scale(1.0 / sqrt(left), t.shift), v3_scale(1.0 / sqrt(left), t.turn)};
    }
}

/* Splits a force at a point into the point's unknowns. `shaft`: the part of the tip's axial force that acts on the adjacent piece of shaft. */
static void put_force(const resting_needle *r, int point, vec3 force, double shaft, double *unknowns) {
    vec3 f = m3_apply_transposed(&r->points[point].at.frame, force);
    int count = r->point_count;
    unknowns[unknown(count, point, 0)] = f.x;
    unknowns[unknown(count, point, 1)] = f.y;
    unknowns[unknown(count, point, 2)] = f.z - shaft;
    if (r->points[point].kind == POINT_TIP) unknowns[unknown(count, point, 2) + 1] = shaft;
}

static void take_forces(const insertion_state *state, resting_needle *r) {
    for (int i = 0; i < r->point_count; i++) {
        const contact_point *p = &r->points[i];
        bool tip = p->kind == POINT_TIP;
        put_force(r, i, point_force(state, p), tip ? state->tip.shaft.traction * (p->share.to - p->share.from) : 0.0, r->anchor_force);
    }
}

/* Sets r->beside to the loads on the tissue that come from its memory: relaxation and, at the tip, damping. */
static void take_memory(const insertion_model *model, const insertion_state *state, int guided, resting_needle *r) {
    for (int i = guided; i < r->point_count; i++) {
        bool tip = r->points[i].kind == POINT_TIP;
        vec3 beside = tip ? v3_add(state->tip.dent.damping, creep_tip_load(model, &state->memory)) : creep_load(model, &state->memory, i - guided);
        put_force(r, i, beside, 0.0, r->beside);
    }
}

/* Returns the load on the tissue from the contact with this handle and id; zero if there is no such active contact. */
static vec3 contact_load(const insertion_model *model, const insertion_state *state, int handle, uint64_t id) {
    for (int k = 0; contact_is_active(state, k); k++)
        if (state->refined.order[k] == handle && state->refined.nodes[handle].id == id) return v3_add(state->contacts[handle].force, creep_load(model, &state->memory, k));
    return v3(0, 0, 0);
}

void resting_bore(const insertion_model *model, const insertion_state *held, resting_needle *r) {
    memset(r->fading, 0, sizeof r->fading);
    for (int i = 0; i < r->point_count; i++) {
        const contact_point *p = &r->points[i];
        vec3 load = v3(0, 0, 0);
        if (p->kind == POINT_TISSUE) load = contact_load(model, held, p->handle, r->anchor.refined.nodes[p->handle].id);
        if (p->kind == POINT_TIP && held->tip.place.phase == TIP_INSIDE) load = v3_add(tip_load(&held->tip), creep_tip_load(model, &held->memory));
        put_force(r, i, load, 0.0, r->fading);
    }
}

static trocar_status linearise(const tick_input *given, const insertion_state *state, inverse *inv, bool loaded, resting_scratch *scratch, resting_needle *r,
                               trocar_error *why) {
    tick_input tick = *given;
    insertion_workspace *w = &scratch->workspace;
    tick_output ignored = {0};
    scratch->state = r->anchor = *state; /* work on a copy, because the linearisation advances the tissue's memory */
    tick.base = (mount){.pose = state->needle.base};
    if (!insertion_linearise(&tick, &scratch->state, w, &ignored, loaded)) return fail(why, TROCAR_BAD_INPUT, "the needle is not in the tissue: only inserted needles can be left");
    const contact_problem *p = &w->problem;
    r->point_count = p->count;
    r->axial_count = p->axial_count;
    r->unknown_count = unknown_count(p);
    r->tip = w->points.tip;
    r->loaded = loaded;
    r->alone = false;
    memcpy(r->points, w->points.list, (size_t)p->count * sizeof *r->points);
    memcpy(r->lower, p->lower, (size_t)p->axial_count * sizeof *r->lower);
    memcpy(r->upper, p->upper, (size_t)p->axial_count * sizeof *r->upper);
    memset(r->anchor_force, 0, sizeof r->anchor_force);
    memset(r->beside, 0, sizeof r->beside);
    memset(r->aside, 0, sizeof r->aside);
    memset(r->slip, 0, sizeof r->slip);
    memset(r->slid, 0, sizeof r->slid);
    memset(r->motion, 0, sizeof r->motion);
    memset(r->free_motion, 0, sizeof r->free_motion);
    take_rows(tick.model->mesh, &scratch->state, r);
    take_places(tick.model, &scratch->state, r);
    take_motions(w, scratch->state.needle.base, tick.model->needle->given.length, r);
    take_forces(state, r);
    take_memory(tick.model, state, w->points.guided, r);
    memcpy(r->force, r->anchor_force, sizeof r->force);
    memcpy(r->free_force, r->anchor_force, sizeof r->free_force);
    return take_coupled(tick.model->mesh, state, w, inv, r, why);
}

static bool is_definite(const resting_needle *r, resting_scratch *scratch) {
    for (int u = 0; u < r->unknown_count; u++)
        for (int v = 0; v <= u; v++) scratch->matrix[v][u] = r->compliance[u][v]; /* column-major */
    return LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', r->unknown_count, scratch->matrix[0], MAX_UNKNOWNS) == 0;
}

/* Copies forces and slips back into the insertion's state. */
static void put_back(const resting_needle *r, insertion_state *state) {
    int count = r->point_count;
    for (int i = 0; i < count; i++) {
        const contact_point *p = &r->points[i];
        const double *f = r->force;
        int face = unknown(count, i, 2);
        bool tip = p->kind == POINT_TIP;
        double along = f[face] + (tip ? f[face + 1] : 0.0), length = p->share.to - p->share.from;
        point_set_force(state, p, m3_apply(&p->at.frame, v3(f[2 * i], f[2 * i + 1], along)));
        if (p->kind == POINT_GUIDE) {
            state->guides[p->guide].faces[p->face].slip += r->slip[i];
        } else if (tip) {
            state->tip.solved.end_force = f[face];
            state->tip.shaft.traction = f[face + 1] / length;
            state->tip.solved.slip += r->slip[i];
            state->tip.shaft.slip += r->slip[i + 1];
            state->tip.shaft.slid += r->slid[i + 1];
        } else {
            shaft_contact *contact = &state->contacts[p->handle];
            contact->shaft.traction = along / length;
            contact->shaft.slip += r->slip[i];
            contact->shaft.slid += r->slid[i];
        }
    }
}

trocar_status resting_soften(const tick_input *given, inverse *inv, resting_scratch *scratch, resting_needle *r, trocar_error *why) {
    tick_input tick = *given;
    insertion_workspace *w = &scratch->workspace;
    tick_output ignored = {0};
    tick.base = (mount){.pose = r->anchor.needle.base};
    insertion_soften(&tick, &r->anchor, w);
    scratch->state = r->anchor;
    if (!insertion_linearise(&tick, &scratch->state, w, &ignored, r->loaded) || w->problem.count != r->point_count)
        return fail(why, TROCAR_NUMERIC, "a resting needle has lost contacts");
    put_back(r, &scratch->state);
    equilibrium_linearise_laws(&tick, &scratch->state, w);
    r->alone = true;
    r->anchor.request.residual_loads = r->anchor.memory.residual;
    take_memory(tick.model, &r->anchor, w->points.guided, r);
    trocar_status status = take_coupled(tick.model->mesh, &scratch->state, w, inv, r, why);
    if (status != TROCAR_OK || !r->loaded || is_definite(r, scratch)) return status;
    r->loaded = false; /* see resting_linearise */
    return resting_soften(given, inv, scratch, r, why);
}

/* An attachment must be stable by itself. So if the needle would buckle under its forces without the tissue, it is linearised again with the stiffness of the
   unloaded needle. */
trocar_status resting_linearise(const tick_input *tick, const insertion_state *state, inverse *inv, resting_scratch *scratch, resting_needle *r,
                                trocar_error *why) {
    trocar_status status = linearise(tick, state, inv, true, scratch, r, why);
    return status != TROCAR_OK || is_definite(r, scratch) ? status : linearise(tick, state, inv, false, scratch, r, why);
}

attachment resting_attachment(const resting_needle *r) {
    return (attachment){.id = r->id, .row_count = r->unknown_count, .rows = r->rows, .compliance = r->compliance[0], .ld = MAX_UNKNOWNS,
                        .motion_count = r->motion_count, .motions = r->motions[0], .motion_ld = MAX_UNKNOWNS};
}

/* ---- letting go --------------------------------------------------------------------------------------------------------------- */

pose pose_moved(pose base, base_motion step) {
    return (pose){v3_add(base.position, step.shift), q_unit(q_multiply(q_exp(step.turn), base.orientation))};
}

/* As long as all points stick, motions q of the base change the forces by M^-1 R q, where M includes the tissue's compliance. In equilibrium, R^T (f + M^-1 R
   q) = 0. */
trocar_status resting_release_step(const resting_needle *r, double size, resting_scratch *scratch, base_motion *step, trocar_error *why) {
    int n = r->unknown_count, m = r->motion_count;
    const contact_problem *p = &scratch->workspace.problem;
    double columns[MAX_MOTIONS][MAX_UNKNOWNS], system[MAX_MOTIONS][MAX_MOTIONS], q[MAX_MOTIONS];
    for (int u = 0; u < n; u++)
        for (int v = 0; v <= u; v++) {
            bool apart = r->compliance[u][v] == 0.0 && u != v;
            scratch->matrix[v][u] = apart ? 0.0 : p->compliance[v][u]; /* column-major */
        }
    memcpy(columns, r->motions, sizeof columns);
    if (LAPACKE_dposv(LAPACK_COL_MAJOR, 'L', n, m, scratch->matrix[0], MAX_UNKNOWNS, columns[0], MAX_UNKNOWNS) != 0)
        return fail(why, TROCAR_NUMERIC, "needle and tissue together are unstable");
    for (int a = 0; a < m; a++) {
        q[a] = 0.0;
        for (int u = 0; u < n; u++) q[a] -= r->motions[a][u] * r->anchor_force[u];
        for (int b = 0; b < m; b++) {
            system[b][a] = 0.0;
            for (int u = 0; u < n; u++) system[b][a] += r->motions[a][u] * columns[b][u];
        }
    }
    if (LAPACKE_dposv(LAPACK_COL_MAJOR, 'L', m, 1, system[0], MAX_MOTIONS, q, MAX_MOTIONS) != 0)
        return fail(why, TROCAR_NUMERIC, "nothing holds the needle");
    *step = (base_motion){{0, 0, 0}, {0, 0, 0}};
    for (int a = 0; a < m; a++) *step = (base_motion){v3_axpy(q[a], r->twists[a].shift, step->shift), v3_axpy(q[a], r->twists[a].turn, step->turn)};
    vec3 axis = q_axis(r->anchor.needle.base.orientation);
    step->shift = v3_axpy((size - 1.0) * v3_dot(axis, step->shift), axis, step->shift);
    double scale = fmin(1.0, fmin(STEP_SHIFT / v3_norm(step->shift), STEP_TURN / v3_norm(step->turn)));
    *step = (base_motion){v3_scale(scale, step->shift), v3_scale(scale, step->turn)};
    return TROCAR_OK;
}

/* ---- as it is now --------------------------------------------------------------------------------------------------------------- */

/* Returns the fraction of the bound on an axial force that remains after sliding, as friction drops from static to kinetic. The tip's cutting force and the
   friction in guides do not drop. */
static double weakened(const insertion_model *model, const resting_needle *r, int i) {
    int point = i < r->point_count ? i : r->point_count - 1;
    const contact_point *p = &r->points[point];
    if (r->slid[i] == 0.0 || p->kind == POINT_GUIDE || (p->kind == POINT_TIP && i < r->point_count)) return 1.0;
    double before = p->kind == POINT_TIP ? r->anchor.tip.shaft.slid : r->anchor.contacts[p->handle].shaft.slid;
    double dry = shaft_friction_limit(model, &p->shaft, before);
    return dry > 0.0 ? shaft_friction_limit(model, &p->shaft, before + r->slid[i]) / dry : 1.0;
}

double resting_upper(const insertion_model *model, const resting_needle *r, int i) { return r->upper[i] * weakened(model, r, i); }
double resting_lower(const insertion_model *model, const resting_needle *r, int i) { return r->lower[i] * weakened(model, r, i); }

static bool has_changed(const resting_needle *r) {
    bool changed = memcmp(r->force, r->anchor_force, (size_t)r->unknown_count * sizeof *r->force) != 0;
    for (int k = 0; k < r->motion_count; k++) changed = changed || r->motion[k] != 0.0;
    return changed;
}

void resting_show(const insertion_model *model, const resting_needle *r, needle_tangent *tangent, insertion_state *state) {
    *state = r->anchor;
    if (!has_changed(r)) return;
    put_back(r, state);
    needle_state *needle = &state->needle;
    base_motion moved = {{0, 0, 0}, {0, 0, 0}};
    for (int k = 0; k < r->motion_count; k++)
        moved = (base_motion){v3_axpy(r->motion[k], r->twists[k].shift, moved.shift), v3_axpy(r->motion[k], r->twists[k].turn, moved.turn)};
    vec3 pivot = needle->base.position;
    quat turn = q_exp(moved.turn);
    int segments = model->needle->given.segments;
    needle->base = pose_moved(needle->base, moved);
    for (int s = 0; s < segments; s++) needle->frames[s] = q_unit(q_multiply(turn, needle->frames[s]));
    for (int j = 0; j <= segments; j++) needle->joints[j] = v3_add(v3_add(pivot, moved.shift), q_rotate(turn, v3_sub(needle->joints[j], pivot)));
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0, 0, 0}};
    for (int i = 0; i < r->point_count; i++) {
        const needle_point *p = &r->points[i].at;
        vec3 force = point_force(state, &r->points[i]);
        for (int k = 0; k < 3; k++) load[p->first + k] = v3_axpy(-p->weights[k], force, load[p->first + k]);
    }
    needle_linearise(model->needle, needle, load, 0, tangent);
    needle_advance(model->needle, tangent, load, needle);
}
