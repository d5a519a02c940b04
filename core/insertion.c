#include "insertion.h"

#include <string.h>

#include "local.h"
#include "tip.h"
#include "window.h"

enum { MOST_ELEMENTS = 64 };             /* looked through ahead of the tip */
static const double LEAST_SHARE = 1e-6;  /* m of shaft that a contact stands for, at least */
static const double TIP_FADE = 3e-3;     /* m of depth over which the tip gets its full hold sideways, */
static const double TIP_BITE = 0.05;     /* N, or the force along the needle with which it gets it on the surface; the hold */
static const double BITE_TIME = 20e-3;   /* s, follows that force with this lag: at once, the two would take turns each tick */
static const double LOOK_BACK = 5e-3;    /* m behind the tip of a free needle: it may have come free below a dented surface */
static const double RETURN_DISTANCE = 5e-3; /* m from where it stuck, within which a buckled needle takes part again */
static const double SURFACE_GRIP = 0.5;  /* friction coefficient of a tip on the surface */

/* ---- model ------------------------------------------------------------------------------------------------------------ */

trocar_status insertion_model_create(insertion_model *model, report *why) { return local_create(model, why); }

void insertion_model_free(insertion_model *model) { local_free(model); }

void insertion_reset(const insertion_model *model, pose base, insertion_state *state) {
    uint64_t serial = state->request.serial, next_id = state->next_id; /* go on counting: an old snapshot must not match */
    double base_compliance = state->base_compliance;
    memset(state, 0, sizeof *state);
    state->request.serial = serial;
    state->next_id = next_id;
    state->base_compliance = base_compliance;
    state->tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .next_contact = NAN};
    needle_rest(model->needle, base, &state->needle);
    tip_engage(model, state);
    window_request(model, state);
}

/* ---- sliding ---------------------------------------------------------------------------------------------------------- */

static vec3 tangent_of(const needle_point *p) { return v3(p->frame.m[0][2], p->frame.m[1][2], p->frame.m[2][2]); }

/* Handles of the last point under the tip that the snapshot covered; false: none. */
static bool tip_handles(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot, int handles[4]) {
    const needle_tip *tip = &state->tip;
    return tip->phase == TIP_INSIDE && tip->known_tet >= 0 && window_covers(snapshot, model->mesh->tets[tip->known_tet], handles);
}

/* Displacement of a handle under the present forces, m. */
static vec3 displacement_of(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot, int handle) {
    vec3 u = v3(0, 0, 0);
    for (int i = 0; i < state->active; i++) {
        mat3 c = compliance_between(snapshot, handle, i);
        u = v3_add(u, m3_apply(&c, state->contacts[i].force));
    }
    int corners[4];
    if (tip_handles(model, state, snapshot, corners)) {
        mat3 c = compliance_to_point(snapshot, corners, state->tip.known_weights, handle);
        u = v3_add(u, m3_apply_transposed(&c, state->tip.force));
    }
    return u;
}

/* Where the material point of the tissue at a contact is carried by the shaft, relative to its nominal place, m. */
static vec3 carried(const insertion_model *model, const insertion_state *state, int index) {
    needle_point p = needle_at(model->needle, &state->needle, state->contacts[index].arc);
    return v3_sub(p.position, state->refined.nodes[index].position);
}

/* Displacement of the tissue by which the shaft carries it WINDOW_SPAN behind the tip, m. */
static vec3 displacement_behind(const insertion_model *model, const insertion_state *state, vec3 at_tip) {
    vec3 ahead = at_tip;
    double ahead_depth = state->tip.depth, sought = ahead_depth - WINDOW_SPAN;
    for (int i = state->active - 1; i >= 0; i--) {
        double depth = state->contacts[i].depth;
        vec3 here = carried(model, state, i);
        if (depth <= sought) return v3_axpy((sought - depth) / (ahead_depth - depth), v3_sub(ahead, here), here);
        ahead = here;
        ahead_depth = depth;
    }
    return ahead;
}

/* The same of the point up to WINDOW_SPAN ahead of the tip in the tissue; the tip's own where the snapshot does not cover it. */
static vec3 displacement_ahead(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot, vec3 direction, vec3 at_tip) {
    const mesh *m = model->mesh;
    double left = WINDOW_SPAN, chord;
    vec3 x = state->tip.nominal;
    int tet = state->tip.tet;
    for (int step = 0; step < MOST_ELEMENTS; step++) {
        int face = mesh_exit(m, tet, x, direction, &chord);
        x = v3_axpy(fmin(left, chord), direction, x);
        left -= chord;
        if (face < 0 || left <= 0.0 || m->neighbours[tet][face] < 0) break;
        tet = m->neighbours[tet][face];
    }
    int handles[4];
    double weights[4];
    tet = refinement_element(m, &state->refined, window_known_contacts(snapshot, &state->refined), tet, x, weights);
    if (!window_covers(snapshot, m->tets[tet], handles)) return at_tip;
    vec3 u = v3(0, 0, 0);
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], displacement_of(model, state, snapshot, handles[c]), u);
    return u;
}

/* Derivative of the tissue's displacement along the track at the tip, as a difference over a fixed length: the gradient in
   the tip's element would depend on the element's size. Behind the tip, the shaft tells; ahead, the mesh. */
static vec3 track_gradient(const insertion_model *model, const insertion_state *state, const compliance_snapshot *snapshot) {
    if (state->tip.phase != TIP_INSIDE || state->active == 0) return v3(0, 0, 0);
    needle_point end = needle_at(model->needle, &state->needle, model->needle->given.length - state->tip.slip);
    vec3 at_tip = v3_sub(end.position, state->tip.nominal);
    vec3 ahead = displacement_ahead(model, state, snapshot, tangent_of(&end), at_tip);
    return v3_scale(0.5 / WINDOW_SPAN, v3_sub(ahead, displacement_behind(model, state, at_tip)));
}

static double slid_on(double slid, double slip, friction_state friction) { return friction == STICK ? 0.0 : slid + fabs(slip); }

/* The shaft moves past its contacts as the last solve said; contacts without a row yet move as their neighbour does. */
static void slide_shaft(insertion_state *state) {
    for (int i = 0; i < state->active; i++) {
        shaft_contact *contact = &state->contacts[i];
        contact->arc = fmax(contact->arc - contact->slip, 0.0); /* a needle pushed in to its base drags what has come there */
        contact->slid = slid_on(contact->slid, contact->slip, contact->friction);
    }
    double neighbour = state->tip.phase == TIP_INSIDE ? state->tip.slip : state->active > 0 ? state->contacts[state->active - 1].slip : 0.0;
    for (int i = state->active; i < contacts_passed(state); i++) state->contacts[i].arc -= neighbour;
    state->tip.shaft_slid = slid_on(state->tip.shaft_slid, state->tip.shaft_slip, state->tip.shaft_friction);
}

/* ---- contacts ----------------------------------------------------------------------------------------------------------- */

/* Friction limit per length after sliding `slid`: static falls to kinetic by slip weakening, independent of the rate. */
static double friction_density(const region_material *material, double slid, double weakening_distance) {
    double excess = material->friction_static - material->friction_kinetic;
    return material->friction_kinetic + excess * exp(-slid / weakening_distance);
}

/* Shaft that a contact stands for, m: half way to its neighbours. */
static double share_of(const insertion_state *state, int index) {
    double depth = state->contacts[index].depth, from = index > 0 ? 0.5 * (state->contacts[index - 1].depth + depth) : 0.0;
    double next = index + 1 < state->active ? state->contacts[index + 1].depth : state->tip.depth;
    return fmax(0.5 * (depth + next) - from, LEAST_SHARE);
}

/* How far the shaft at a contact that slides is ahead of the tissue, which follows it elastically up to the friction limit, m. */
static double elastic_slip(const insertion_model *model, const insertion_state *state, int index, double dt) {
    const shaft_contact *contact = &state->contacts[index];
    const region_material *material = &model->materials[model->mesh->region[state->refined.nodes[index].tet]];
    double dry = contact->friction * friction_density(material, contact->slid, model->settings.weakening_distance);
    double share = share_of(state, index), stiffness = share / local_line_force(material).axial;
    return local_of_share(contact->log_axial, stiffness, contact->surplus) * share * (dry + material->friction_viscous * contact->slip / dt);
}

/* A contact whose row has arrived: its material point on the shaft is where friction is at its limit, as it was for the
   tip that left it there. */
static void activate_contact(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, int index, double dt) {
    shaft_contact *contact = &state->contacts[index];
    const added_node *node = &state->refined.nodes[index];
    local_compliance logarithm = local_logarithm(model, node->tet, node->position);
    contact->log_lateral = logarithm.lateral;
    contact->log_axial = logarithm.axial;
    contact->surplus = local_surplus(model, node->tet, node->position);
    double ahead = elastic_slip(model, state, index, dt) + contact->slip; /* it slides on in this tick, as the tip did */
    vec3 tissue = v3_add(node->position, displacement_of(model, state, snapshot, index));
    needle_point p = needle_at(model->needle, &state->needle, contact->arc);
    contact->arc += ahead - v3_dot(tangent_of(&p), v3_sub(p.position, tissue));
    contact->arc = fmin(fmax(contact->arc, 0.0), model->needle->given.length);
}

static void accept_snapshot(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, double dt, insertion_wrench *wrench) {
    int known = window_known_contacts(snapshot, &state->refined), passed = contacts_passed(state);
    while (state->active < known && state->active < passed) {
        int index = state->active++;
        state->contacts[index].force = v3(0, 0, 0);
        activate_contact(model, state, snapshot, index, dt);
        wrench->events |= EVENT_ADDED;
    }
}

/* Handles of the corners around the tip; where the worker is late, around the last point that the snapshot covered. False:
   none at all. The tip's force acts on the nominal mesh by interpolation: a node of its own would be stiffer the nearer it
   came to a face, and what it adds is below what the mesh resolves. */
static bool tip_known(const insertion_model *model, insertion_state *state, const compliance_snapshot *snapshot, int handles[4], insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (tip->phase != TIP_INSIDE) return false;
    double weights[4];
    int tet = refinement_element(model->mesh, &state->refined, window_known_contacts(snapshot, &state->refined), tip->tet, tip->nominal, weights);
    if (tet != tip->tet && !window_covers(snapshot, model->mesh->tets[tet], handles)) /* the window follows the nominal mesh */
        mesh_barycentric(model->mesh, tet = tip->tet, tip->nominal, weights);
    if (window_covers(snapshot, model->mesh->tets[tet], handles)) {
        tip->known_tet = tet;
        memcpy(tip->known_weights, weights, sizeof weights);
        return true;
    }
    wrench->events |= EVENT_LATE;
    return tip_handles(model, state, snapshot, handles);
}

/* ---- profile ------------------------------------------------------------------------------------------------------------ */

static void begin_profile(insertion_profile *p) {
    memset(p->spent, 0, sizeof p->spent);
    if (p->clock) p->last = p->clock();
}

/* What has passed since the last call went into this stage. */
static void end_stage(insertion_profile *p, insertion_stage stage) {
    if (!p->clock) return;
    int64_t now = p->clock();
    p->spent[stage] += now - p->last;
    p->last = now;
}

/* ---- one solve ---------------------------------------------------------------------------------------------------------- */

/* Each point stands for the track half way to its neighbours; the tip for the rest. */
static void share_length(const insertion_state *state, bool tip, insertion_workspace *w) {
    double from = 0.0, end = state->tip.depth;
    for (int i = 0; i < state->active; i++) {
        double to = i + 1 < state->active ? 0.5 * (state->contacts[i].depth + state->contacts[i + 1].depth)
                                          : tip ? 0.5 * (state->contacts[i].depth + end) : end;
        w->from[i] = from;
        from = w->to[i] = fmax(to, from + LEAST_SHARE);
    }
    if (tip) w->from[state->active] = from, w->to[state->active] = fmax(end, from + LEAST_SHARE);
}

/* What a part of the shaft meets in the regions that it lies in. */
typedef struct {
    double dry, viscous;         /* friction limit, N, and viscous friction, N s/m */
    double lateral, axial;       /* m of shaft over the local compliance of a line force per logarithm, N/m */
} shaft_resistance;

static shaft_resistance resistance_between(const insertion_model *model, const insertion_state *state, double from, double to, double slid) {
    shaft_resistance sum = {0};
    for (int k = 0; k < state->stratum_count; k++) {
        double top = k > 0 ? fmax(from, state->strata[k].depth) : from;
        double length = (k + 1 < state->stratum_count ? fmin(to, state->strata[k + 1].depth) : to) - top;
        if (length <= 0.0) continue;
        const region_material *material = &model->materials[state->strata[k].region];
        local_compliance line = local_line_force(material);
        sum.dry += length * friction_density(material, slid, model->settings.weakening_distance);
        sum.viscous += length * material->friction_viscous;
        sum.lateral += length / line.lateral;
        sum.axial += length / line.axial;
    }
    return sum;
}

static void bound_friction(const insertion_model *model, const insertion_state *state, int i, int share, double slid, friction_state last,
                           double dt, insertion_workspace *w) {
    contact_problem *p = &w->problem;
    shaft_resistance friction = resistance_between(model, state, w->from[share], w->to[share], slid);
    p->upper[i] = friction.dry;
    p->lower[i] = -friction.dry;
    p->viscosity[i][0] = p->viscosity[i][1] = friction.viscous / dt;
    p->state[i] = last;
}

/* The tip bears two forces along the needle: what it cuts, or is stopped by, and friction of the shaft next to it. */
static void bound_tip(const insertion_model *model, const insertion_state *state, double dt, insertion_workspace *w) {
    contact_problem *p = &w->problem;
    const needle_tip *tip = &state->tip;
    int t = state->active;
    p->upper[t] = tip_resistance(model, tip);
    p->lower[t] = 0.0;
    p->viscosity[t][0] = 0.0;
    p->viscosity[t][1] = tip->blocked_by != NOT_BLOCKED ? 0.0 : model->materials[model->mesh->region[tip->tet]].cutting_viscosity / dt;
    p->state[t] = tip->friction;
    bound_friction(model, state, t + 1, t, tip->shaft_slid + fabs(tip->shaft_slip), tip->shaft_friction, dt, w);
}

static void bound_contacts(const insertion_model *model, const insertion_state *state, bool tip, double dt, insertion_workspace *w) {
    for (int i = 0; i < state->active; i++) {
        const shaft_contact *contact = &state->contacts[i];
        bound_friction(model, state, i, i, contact->slid + fabs(contact->slip), contact->friction, dt, w);
    }
    if (tip) bound_tip(model, state, dt, w);
}

static mat3 needle_block(const needle_tangent *tangent, const needle_point *p, const needle_point *q) {
    mat3 sum = {{{0}}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double w = p->weights[i] * q->weights[j];
            const double *block = &tangent->compliance[3 * (p->first + i)][3 * (q->first + j)];
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) sum.m[a][b] += w * block[a * NEEDLE_LD + b];
        }
    return sum;
}

/* Unknowns: two sideways for each point, then one along the needle for each, then that of the shaft next to the tip. */
static int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }

static void put_block(contact_problem *p, int i, int j, const mat3 *compliance, const mat3 *frame_i, const mat3 *frame_j) {
    mat3 half = m3_multiply(compliance, frame_j), turned = m3_transposed(frame_i);
    turned = m3_multiply(&turned, &half);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            int row = unknown(p->count, i, a), column = unknown(p->count, j, b);
            if (row >= column) p->compliance[row][column] = turned.m[a][b];
            else p->compliance[column][row] = turned.m[a][b];
        }
}

/* The shaft next to the tip pulls at the same point along the same line: as yet a copy of the tip's last row and column. */
static void repeat_tip(contact_problem *p) {
    int tip = unknown(p->count, p->count - 1, 2), shaft = tip + 1;
    memcpy(p->compliance[shaft], p->compliance[tip], (size_t)shaft * sizeof **p->compliance);
    p->compliance[shaft][shaft] = p->compliance[tip][tip];
}

/* Compliance of tissue, needle and the hold on its base between all points, in their frames; local compliance on the diagonal. */
static void assemble(insertion_workspace *w, const insertion_state *state, const compliance_snapshot *snapshot, bool tip) {
    contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++)
        for (int j = 0; j <= i; j++) {
            mat3 tissue = tip && i == p->count - 1 ? w->tip_row[j] : compliance_between(snapshot, i, j);
            mat3 needle = needle_block(&w->tangent, &w->points[i], &w->points[j]);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) tissue.m[a][b] += needle.m[a][b] + (a == b ? state->base_compliance : 0.0);
            put_block(p, i, j, &tissue, &w->points[i].frame, &w->points[j].frame);
        }
    if (tip) repeat_tip(p);
    for (int i = 0; i < p->count; i++) {
        for (int a = 0; a < 3; a++) p->compliance[unknown(p->count, i, a)][unknown(p->count, i, a)] += a < 2 ? w->lateral[i] : w->axial[i];
        const needle_point *at = &w->points[i];
        vec3 gap = v3_sub(v3_sub(at->position, state->base_shift), w->nominal[i]);
        for (int k = 0; k < 3; k++) gap = v3_axpy(at->weights[k], w->tangent.drift[at->first + k], gap);
        gap = m3_apply_transposed(&at->frame, gap);
        p->gap[unknown(p->count, i, 0)] = gap.x;
        p->gap[unknown(p->count, i, 1)] = gap.y;
        p->gap[unknown(p->count, i, 2)] = gap.z;
    }
    if (!tip) return;
    int shaft = unknown(p->count, p->count, 2);
    p->compliance[shaft][shaft] += w->axial[p->count];
    p->gap[shaft] = p->gap[shaft - 1] + state->tip.stretch;
}

/* Local compliances of the points, m/N. Shaft: by its share of length in each region. Tip: sideways as shaft of its share and
   one radius more (fading out at the surface unless it is pressed in); along the needle as a disc under the cutting force, beside
   the shaft next to it. */
static void find_local_compliance(const insertion_model *model, const insertion_state *state, insertion_workspace *w, bool tip) {
    for (int i = 0; i < state->active; i++) {
        const shaft_contact *contact = &state->contacts[i];
        shaft_resistance shaft = resistance_between(model, state, w->from[i], w->to[i], 0.0);
        w->lateral[i] = local_of_share(contact->log_lateral, shaft.lateral, contact->surplus);
        w->axial[i] = local_of_share(contact->log_axial, shaft.axial, contact->surplus);
    }
    if (!tip) return;
    int t = state->active;
    double radius = model->needle->radius, hold = fmin(1.0, state->tip.depth / TIP_FADE + state->tip.pressing / TIP_BITE);
    local_compliance local = local_at(model, state->tip.tet, state->tip.nominal);
    w->lateral[t] = local.lateral / fmax(hold * (w->to[t] - w->from[t] + radius), 1e-9);
    w->axial[t] = local_at_tip(model, state->tip.tet, state->tip.nominal, state->tip.depth);
    shaft_resistance shaft = resistance_between(model, state, w->from[t], w->to[t], 0.0);
    w->axial[t + 1] = local_logarithm(model, state->tip.tet, state->tip.nominal).axial / shaft.axial;
}

static void follow_pressing(needle_tip *tip, const needle_point *p, double dt) {
    double pressing = fmax(v3_dot(tip->force, tangent_of(p)), 0.0);
    tip->pressing += (pressing - tip->pressing) * -expm1(-dt / BITE_TIME);
}

static void locate_points(const insertion_model *model, const insertion_state *state, insertion_workspace *w, bool tip) {
    for (int i = 0; i < state->active; i++) {
        w->points[i] = needle_at(model->needle, &state->needle, state->contacts[i].arc);
        w->nominal[i] = state->refined.nodes[i].position;
    }
    if (!tip) return;
    w->points[state->active] = needle_at(model->needle, &state->needle, model->needle->given.length);
    w->nominal[state->active] = state->tip.nominal;
}

/* Forces of the contacts on the needle's joints. */
static void load_needle(const insertion_state *state, const insertion_workspace *w, bool tip, int segments, vec3 *load) {
    memset(load, 0, (size_t)(segments + 1) * sizeof *load);
    for (int i = 0; i < state->active + tip; i++) {
        vec3 force = i < state->active ? state->contacts[i].force : state->tip.force;
        const needle_point *p = &w->points[i];
        for (int k = 0; k < 3; k++) load[p->first + k] = v3_axpy(-p->weights[k], force, load[p->first + k]);
    }
}

/* The spring that holds the base gives way to the sum of forces. */
static void shift_base(const insertion_model *model, insertion_state *state, const vec3 *load) {
    if (state->base_compliance == 0.0) return;
    vec3 sum = v3(0, 0, 0), before = state->base_shift;
    for (int j = 0; j <= model->needle->given.segments; j++) sum = v3_add(sum, load[j]);
    state->base_shift = v3_scale(state->base_compliance, sum);
    pose base = state->needle.base;
    base.position = v3_add(base.position, v3_sub(state->base_shift, before));
    needle_hold(model->needle, base, &state->needle);
}

static void take_forces(insertion_state *state, const insertion_workspace *w, bool tip) {
    const contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        bool at_tip = tip && i == p->count - 1;
        double along = p->force[2 * p->count + i] + (at_tip ? p->force[2 * p->count + i + 1] : 0.0);
        vec3 force = m3_apply(&w->points[i].frame, v3(p->force[2 * i], p->force[2 * i + 1], along));
        if (at_tip) {
            state->tip.force = force;
            state->tip.slip = p->slip[i];
            state->tip.friction = p->state[i];
            state->tip.shaft_slip = p->slip[i + 1];
            state->tip.shaft_friction = p->state[i + 1];
        } else {
            state->contacts[i].force = force;
            state->contacts[i].slip = p->slip[i];
            state->contacts[i].friction = p->state[i];
        }
    }
}

/* No equilibrium: the needle has buckled beyond what the tissue holds. */
static void give_up(insertion_state *state, insertion_wrench *wrench) {
    for (int i = 0; i < state->active; i++) {
        state->contacts[i].force = v3(0, 0, 0);
        state->contacts[i].slip = 0.0;
    }
    state->tip.force = v3(0, 0, 0);
    state->tip.slip = state->tip.shaft_slip = state->tip.stretch = 0.0;
    state->base_shift = v3(0, 0, 0);
    state->buckled = true;
    wrench->events |= EVENT_UNSTABLE;
}

/* A buckled needle counts as straight and without force until its tip is back at the point where it stuck. */
static void wait_for_return(const insertion_model *model, insertion_state *state, pose base, insertion_wrench *wrench) {
    needle_rest(model->needle, base, &state->needle);
    vec3 off = v3_sub(state->needle.joints[model->needle->given.segments], state->tip.nominal);
    state->buckled = v3_norm(off) > RETURN_DISTANCE;
    if (state->buckled) wrench->events |= EVENT_UNSTABLE;
}

/* Newton passes on the needle's shape around the condensed contact problem. */
static void find_equilibrium(const insertion_model *model, insertion_state *state, insertion_workspace *w, const compliance_snapshot *snapshot,
                             bool tip, const int handles[4], double dt, insertion_wrench *wrench) {
    contact_problem *p = &w->problem;
    int segments = model->needle->given.segments;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    p->count = state->active + tip;
    p->axial_count = p->count + tip;
    share_length(state, tip, w);
    if (tip) {
        const double *weights = state->tip.known_weights;
        mat3 own = {{{0}}};
        for (int c = 0; c < 4; c++) {
            mat3 row = compliance_to_point(snapshot, handles, weights, handles[c]);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++) own.m[a][b] += weights[c] * row.m[a][b];
        }
        for (int i = 0; i < state->active; i++) w->tip_row[i] = compliance_to_point(snapshot, handles, weights, i);
        w->tip_row[state->active] = own;
    }
    locate_points(model, state, w, tip);
    find_local_compliance(model, state, w, tip);
    load_needle(state, w, tip, segments, load);
    end_stage(&w->profile, INSERTION_TISSUE);
    for (int pass = 1;; pass++) {
        wrench->passes++;
        int first = segments;
        for (int i = 0; i < p->count; i++) first = w->points[i].first < first ? w->points[i].first : first;
        needle_linearise(model->needle, &state->needle, load, first, &w->tangent);
        end_stage(&w->profile, INSERTION_NEEDLE);
        bound_contacts(model, state, tip, dt, w);
        assemble(w, state, snapshot, tip);
        if (contact_solve(p) != TROCAR_OK) {
            give_up(state, wrench);
            return;
        }
        wrench->switches += p->switches;
        take_forces(state, w, tip);
        end_stage(&w->profile, INSERTION_CONTACT);
        load_needle(state, w, tip, segments, load);
        shift_base(model, state, load);
        double turned = needle_advance(model->needle, &w->tangent, load, &state->needle);
        locate_points(model, state, w, tip);
        end_stage(&w->profile, INSERTION_NEEDLE);
        bool found = turned * turned * model->needle->given.length < model->settings.tolerance;
        if (!found && pass < model->settings.max_passes) continue;
        bool saddle = p->negative < w->tangent.unstable; /* it would not stay there; seen on the way to the solution, it counts if seen twice */
        if (saddle && (found || state->saddle)) give_up(state, wrench);
        state->saddle = saddle;
        return;
    }
}

/* ---- the tick ----------------------------------------------------------------------------------------------------------- */

/* Before it is in, the tip grips the surface by friction: pushed sideways harder than that, it glides. */
static void glide_on_surface(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    const needle_tip *tip = &state->tip;
    vec3 axis = q_rotate(state->needle.frames[model->needle->given.segments - 1], v3(0, 0, 1));
    double pressing = v3_dot(tip->force, axis);
    vec3 sideways = v3_axpy(-pressing, axis, tip->force);
    double excess = v3_norm(sideways) - SURFACE_GRIP * fmax(pressing, 0.0);
    if (excess <= 0.0) return;
    double compliance = local_at(model, tip->tet, tip->nominal).lateral / model->needle->radius;
    tip_glide(model, state, axis, v3_scale(excess * compliance / v3_norm(sideways), sideways), wrench);
}

/* Needle in the air: straight. Touching the outer surface starts an insertion; drawn out of a dent, it touches nothing. */
static void move_freely(const insertion_model *model, insertion_state *state, pose base, insertion_wrench *wrench) {
    int n = model->needle->given.segments;
    vec3 before = state->needle.joints[n];
    needle_rest(model->needle, base, &state->needle);
    vec3 axis = q_rotate(base.orientation, v3(0, 0, 1)), now = state->needle.joints[n];
    bool advancing = v3_dot(v3_sub(now, before), axis) > 0.0;
    tip_touch(model, state, v3_axpy(advancing ? -LOOK_BACK : 0.0, axis, before), now, wrench);
}

static void sum_wrench(const insertion_state *state, const insertion_workspace *w, bool tip, insertion_wrench *wrench) {
    wrench->force = wrench->torque = v3(0, 0, 0);
    for (int i = 0; i < state->active + tip; i++) {
        vec3 on_needle = v3_scale(-1.0, i < state->active ? state->contacts[i].force : state->tip.force);
        vec3 lever = v3_sub(w->points[i].position, state->needle.base.position);
        wrench->force = v3_add(wrench->force, on_needle);
        wrench->torque = v3_add(wrench->torque, v3_cross(lever, on_needle));
    }
    wrench->depth = state->tip.phase == TIP_FREE ? 0.0 : state->tip.depth;
    wrench->contacts = state->active;
}

/* The tip goes on in the tissue and the shaft next to it slides, each as the last solve said: not always equally far. */
static void move_tip(const insertion_model *model, insertion_state *state, vec3 gradient, double dt, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    double before = tip->depth, slid = tip->shaft_slip;
    bool beyond = tip->phase == TIP_BEYOND;
    tip_move(model, state, gradient, wrench);
    if (tip->phase != TIP_INSIDE) return;
    tip->stretch += tip->depth - before - slid;
    int last = contacts_passed(state) - 1;
    if (beyond) tip->stretch = last < 0 ? 0.0 : elastic_slip(model, state, last, dt);
}

static void step(const insertion_model *model, insertion_state *state, insertion_workspace *scratch,
                 const compliance_snapshot *snapshot, pose base, double dt, insertion_wrench *wrench) {
    if (state->buckled) {
        wait_for_return(model, state, base, wrench);
        wrench->depth = state->tip.depth;
        wrench->contacts = state->active;
        if (state->buckled) return;
    } else if (state->tip.phase == TIP_FREE) {
        move_freely(model, state, base, wrench);
    } else {
        slide_shaft(state);
        vec3 gradient = track_gradient(model, state, snapshot);
        pose shifted = {v3_add(base.position, state->base_shift), base.orientation};
        needle_hold(model->needle, shifted, &state->needle);
        move_tip(model, state, gradient, dt, wrench);
        if (state->tip.phase == TIP_INSIDE && state->tip.depth == 0.0) glide_on_surface(model, state, wrench);
    }
    accept_snapshot(model, state, snapshot, dt, wrench);
    int handles[4];
    bool tip = tip_known(model, state, snapshot, handles, wrench);
    if (state->active + tip > 0) find_equilibrium(model, state, scratch, snapshot, tip, handles, dt, wrench);
    else state->base_shift = v3(0, 0, 0);
    if (tip) follow_pressing(&state->tip, &scratch->points[state->active], dt);
    tip_puncture(model, state, wrench);
    sum_wrench(state, scratch, tip, wrench);
}

/* A fraction of the way from the pose held to the new one. */
static pose between(pose from, pose to, double fraction) {
    vec3 turn = q_log(q_multiply(to.orientation, q_conjugate(from.orientation)));
    return (pose){v3_axpy(fraction, v3_sub(to.position, from.position), from.position),
                  q_unit(q_multiply(q_exp(v3_scale(fraction, turn)), from.orientation))};
}

void insertion_tick(const insertion_model *model, insertion_state *state, insertion_workspace *scratch,
                    const compliance_snapshot *snapshot, pose base, double dt, insertion_wrench *wrench) {
    *wrench = (insertion_wrench){.membrane = -1};
    begin_profile(&scratch->profile);
    pose held = state->needle.base;
    held.position = v3_sub(held.position, state->base_shift);
    dt = fmax(dt, 1e-6);
    int steps = (int)fmin(ceil(dt / model->settings.longest_step - 1e-6), model->settings.most_steps);
    for (int i = 1; i < steps; i++) step(model, state, scratch, snapshot, between(held, base, (double)i / steps), dt / steps, wrench);
    step(model, state, scratch, snapshot, base, steps > 1 ? dt / steps : dt, wrench);
    window_request(model, state);
    end_stage(&scratch->profile, INSERTION_WRENCH);
}

/* ---- export ------------------------------------------------------------------------------------------------------------- */

void insertion_refinement(const insertion_state *state, refinement *out) {
    out->count = state->active;
    memcpy(out->nodes, state->refined.nodes, (size_t)state->active * sizeof *out->nodes);
}

void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added) {
    const needle_tip *tip = &state->tip;
    for (int i = 0; i < state->active; i++) added[i] = state->contacts[i].force;
    if (tip->phase != TIP_INSIDE || tip->known_tet < 0) return;
    for (int c = 0; c < 4; c++) {
        vec3 *corner = &nominal[model->mesh->tets[tip->known_tet][c]];
        *corner = v3_axpy(tip->known_weights[c], tip->force, *corner);
    }
}
