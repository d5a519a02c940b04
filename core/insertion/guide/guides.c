#include "insertion/guide/guides.h"

static const double LEAST_STIFFNESS = 1e-2; /* N/m: tangential stiffness of a hole's edge where the needle touches it without force. Rounding tolerance */
static const double LEAST_SLOPE = 0.3; /* cosine, below 1: a hole no longer guides a needle if the cosine of the angle between their axes is below this. Chosen:
                                          70 degrees, beyond any real needle */
static const double TOLERANCE = 1e-6; /* m: the passes end when needle and edge agree to within this distance. Chosen: a tolerance ten times smaller takes up to
                                         1.6 times as many passes */
static const double FORCE_TOLERANCE = 0.01; /* fraction: the passes end when the relative error in the edge's force is below this, so that light touches are
                                               resolved. Chosen like TOLERANCE */
static const double ROUNDING = 1e-12; /* m: needle and edge agree in any case if they are closer than this. Rounding tolerance */

static const guide *guide_of(const tick_input *tick, const contact_points *points, int point) { return &tick->model->guides[points->list[point].guide]; }
static const guide_state *state_of(const insertion_state *state, const contact_points *points, int point) { return &state->guides[points->list[point].guide]; }
static const guide_contact *contact_of(const insertion_state *state, const contact_points *points, int point) { return &state_of(state, points,
                                       point)->faces[points->list[point].face]; }

/* Returns how far (m) the plane of a guide point is behind the guide's front face. */
static double plane_of(const guide_state *state, int face) { return face == 0 ? 0.0 : state->depth; }

/* True if this guide point is at the tip, as it is while the tip is inside the plate. */
static bool at_tip(const guide *g, const guide_state *state, int face) { return face == 1 && state->depth < g->thickness; }

/* Returns the distance (m) along the needle from the plane through `centre` to the point. */
static double beyond_plane(const needle_point *p, vec3 centre, vec3 normal) {
    return v3_dot(v3_sub(p->position, centre), normal) / v3_dot(needle_along(p), normal);
}

/* ---- in and out of holes ----------------------------------------------------------------------------------------------- */

/* Returns the arc at which the centreline crosses the plane, by Newton's method from a close guess. A few steps are enough because the centreline is nearly
   straight near the plane. */
static double crossing(const tick_input *tick, const insertion_state *state, double arc, vec3 centre, vec3 normal) {
    double length = tick->model->needle->given.length;
    for (int i = 0; i < 3; i++) {
        needle_point p = needle_at(tick->model->needle, &state->needle, arc);
        double step = beyond_plane(&p, centre, normal);
        if (!isfinite(step)) break; /* the needle is parallel to the plate */
        arc = smaller_of(larger_of(arc - step, 0.0), length);
    }
    return arc;
}

/* Records that the tip has crossed the front face. */
static void pass_front(const tick_input *tick, const insertion_state *state, const guide *g, guide_state *s, double behind) {
    double arc = crossing(tick, state, tick->model->needle->given.length - behind, g->origin, g->normal);
    vec3 at = needle_at(tick->model->needle, &state->needle, arc).position;
    int hole = guide_hole_at(g, at);
    s->passage = hole == BESIDE_PLATE ? GUIDE_BESIDE : hole == NO_HOLE ? GUIDE_MISSED : GUIDE_IN_HOLE;
    if (s->passage != GUIDE_IN_HOLE) return;
    s->hole = hole;
    s->faces[0].arc = arc;
    s->faces[1].arc = tick->model->needle->given.length;
}

/* True if the needle is at a larger angle to its hole than any real needle could be. */
static bool lies_across(const tick_input *tick, const insertion_state *state, const guide *g, const guide_state *s) {
    needle_point p = needle_at(tick->model->needle, &state->needle, s->faces[0].arc);
    return v3_dot(needle_along(&p), g->normal) < LEAST_SLOPE;
}

/* For each face, updates which point of the needle is on it, unless friction holds that point. */
static void follow_faces(const tick_input *tick, const insertion_state *state, const guide *g, guide_state *s) {
    for (int f = 0; f < GUIDE_FACES; f++) {
        guide_contact *face = &s->faces[f];
        if (at_tip(g, s, f)) face->arc = tick->model->needle->given.length;
        else if (!face->touching) face->arc = crossing(tick, state, face->arc, guide_hole(g, s->hole, plane_of(s, f)), g->normal);
    }
}

void guides_follow(const tick_input *tick, insertion_state *state, tick_output *output) {
    const insertion_model *model = tick->model;
    vec3 base = state->needle.joints[0], tip = state->needle.joints[model->needle->given.segments];
    for (int i = 0; i < model->guide_count; i++) {
        const guide *g = &model->guides[i];
        guide_state *s = &state->guides[i];
        double behind = v3_dot(v3_sub(tip, g->origin), g->normal);
        bool from_front = s->passage != GUIDE_AHEAD || v3_dot(v3_sub(base, g->origin), g->normal) < 0.0;
        if (!(behind > 0.0 && from_front)) {
            *s = (guide_state){.passage = GUIDE_AHEAD};
            continue;
        }
        if (s->passage == GUIDE_AHEAD) pass_front(tick, state, g, s, behind);
        if (s->passage == GUIDE_IN_HOLE && lies_across(tick, state, g, s)) *s = (guide_state){.passage = GUIDE_MISSED};
        if (s->passage == GUIDE_MISSED) output->events |= EVENT_MISSED_GUIDE;
        if (s->passage != GUIDE_IN_HOLE) continue;
        s->depth = fmin(behind, g->thickness);
        follow_faces(tick, state, g, s);
    }
}

void guides_slide(const insertion_model *model, insertion_state *state) {
    for (int i = 0; i < model->guide_count; i++)
        for (int f = 0; f < GUIDE_FACES; f++) {
            guide_contact *face = &state->guides[i].faces[f];
            face->arc = fmin(fmax(face->arc - face->slip, 0.0), model->needle->given.length);
            face->slip = 0.0;
        }
}

bool guides_hold(const insertion_model *model, const insertion_state *state) {
    for (int i = 0; i < model->guide_count; i++)
        if (state->guides[i].passage == GUIDE_IN_HOLE) return true;
    return false;
}

/* ---- points of contact ------------------------------------------------------------------------------------------------- */

void guides_list(const tick_input *tick, const insertion_state *state, contact_points *points) {
    const insertion_model *model = tick->model;
    points->guided = 0;
    for (int i = 0; i < model->guide_count; i++) {
        const guide_state *s = &state->guides[i];
        int faces = s->passage != GUIDE_IN_HOLE ? 0 : model->guides[i].thickness > 0.0 ? 2 : 1;
        for (int f = 0; f < faces; f++)
            points->list[points->guided++] = (contact_point){.kind = POINT_GUIDE, .handle = NO_HANDLE, .guide = i, .face = f, .arc = s->faces[f].arc};
    }
}

/* Returns the map from the needle's lateral displacement to the displacement in the face. The map is oblique if the needle is not normal to the plate. */
static crossing_map map_of(const guide *g, const needle_point *at) {
    crossing_map j;
    vec3 along = needle_along(at);
    for (int i = 0; i < 2; i++) {
        vec3 side = m3_column(&at->frame, i);
        vec3 moved = v3_axpy(-v3_dot(side, g->normal) / v3_dot(along, g->normal), along, side);
        for (int a = 0; a < 2; a++) j.m[a][i] = v3_dot(g->across[a], moved);
    }
    double determinant = j.m[0][0] * j.m[1][1] - j.m[0][1] * j.m[1][0];
    j.inverse[0][0] = j.m[1][1] / determinant, j.inverse[0][1] = -j.m[0][1] / determinant;
    j.inverse[1][0] = -j.m[1][0] / determinant, j.inverse[1][1] = j.m[0][0] / determinant;
    return j;
}

/* Returns an upper bound (m/N) on the needle's compliance to a lateral force at a face. It ignores the tissue, which may also support the needle. */
static double needle_compliance(const tick_input *tick, double arc) {
    return arc * arc * arc / (3.0 * tick->model->needle->bending) + tick->base.compliance;
}

/* The edge is a spring of stiffness k that acts on the part of the offset d beyond the clearance c:
       f = k (|d| - c) d / |d|
   After a pass, the needle may be far off the edge or on another side of it, so the spring is not linearised about the needle's position. Instead, it is
   linearised about the point of the edge where the needle would rest if its force stayed proportional to its deflection, with compliance r. That point is in
   the direction n of d + r f, and the force there is (|d + r f| - c) / (r + 1 / k). The solution is the same. Perpendicular to n, the stiffness is that of a
   force that turns with the point. */
static void find_touch(const tick_input *tick, const insertion_state *state, contact_points *points, hole_edge *edges, int point) {
    contact_point *p = &points->list[point];
    hole_edge *edge = &edges[point];
    const guide *g = guide_of(tick, points, point);
    const guide_state *s = state_of(state, points, point);
    const guide_contact *face = &s->faces[p->face];
    vec3 centre = guide_hole(g, s->hole, plane_of(s, p->face));
    p->target = v3_axpy(-beyond_plane(&p->at, centre, g->normal), needle_along(&p->at), p->at.position);
    vec3 offset = v3_sub(p->target, centre), given = m3_apply_transposed(&p->at.frame, face->force);
    double c = g->clearance, f[2], n[2];
    edge->map = map_of(g, &p->at);
    for (int a = 0; a < 2; a++) {
        edge->offset[a] = v3_dot(offset, g->across[a]);
        f[a] = edge->map.inverse[0][a] * given.x + edge->map.inverse[1][a] * given.y;
    }
    double force = length_of(f[0], f[1]), r = needle_compliance(tick, p->arc);
    if (r * force > c) r = c / force;
    for (int a = 0; a < 2; a++) n[a] = edge->offset[a] + r * f[a];
    double reach = length_of(n[0], n[1]);
    edge->touched = reach > c || c == 0.0;
    edge->pulled = edge->touched ? 0.0 : force;
    double compliance = r + 1.0 / g->stiffness;
    edge->pressed = edge->touched ? (reach - c) / compliance : 0.0;
    for (int a = 0; a < 2; a++) edge->normal[a] = reach > 0.0 ? n[a] / reach : a == 0;
    double rubs = edge->touched && !at_tip(g, s, p->face) ? length_of(given.x, given.y) : 0.0; /* lateral force that will set the friction bound in the next
                                                                                                  pass */
    double missing = length_of(f[0] - edge->pressed * edge->normal[0], f[1] - edge->pressed * edge->normal[1]) + g->friction * fabs(rubs - edge->rubbing);
    double allowed = fmin(TOLERANCE, fmax(FORCE_TOLERANCE * edge->pressed * compliance, ROUNDING));
    edge->agrees = missing * compliance <= allowed;
}

/* Handles a pass in which the needle would have to pull on the edges at both faces of a plate. Releases only the face with the larger pull: the pull at the
   other face is usually just a result of it. */
static void keep_one_face(hole_edge *edges, int front) {
    hole_edge *edge = &edges[front];
    if (edge[0].pulled == 0.0 || edge[1].pulled == 0.0) return;
    hole_edge *kept = &edge[edge[0].pulled > edge[1].pulled];
    double distance = length_of(kept->offset[0], kept->offset[1]);
    if (distance == 0.0) return;
    kept->touched = true;
    for (int a = 0; a < 2; a++) kept->normal[a] = kept->offset[a] / distance;
}

static void find_yield(const tick_input *tick, contact_points *points, hole_edge *edges, int point) {
    contact_point *p = &points->list[point];
    hole_edge *edge = &edges[point];
    const guide *g = guide_of(tick, points, point);
    if (!edge->touched) return;
    double c = g->clearance, k = g->stiffness, *n = edge->normal, back[2];
    double radial = 1.0 / k, around = 1.0 / fmax(c > 0.0 ? edge->pressed / (c + edge->pressed / k) : k, LEAST_STIFFNESS);
    double plane[2][2] = {{radial * n[0] * n[0] + around * n[1] * n[1], (radial - around) * n[0] * n[1]},
                          {(radial - around) * n[0] * n[1], radial * n[1] * n[1] + around * n[0] * n[0]}};
    const double (*j)[2] = (const double (*)[2])edge->map.inverse;
    for (int i = 0, entry = 0; i < 2; i++) {
        back[i] = j[i][0] * (edge->offset[0] - c * n[0]) + j[i][1] * (edge->offset[1] - c * n[1]);
        for (int q = i; q < 2; q++, entry++) {
            edge->lateral[entry] = 0.0;
            for (int a = 0; a < 2; a++)
                for (int b = 0; b < 2; b++) edge->lateral[entry] += j[i][a] * plane[a][b] * j[q][b];
        }
    }
    p->target = v3_sub(p->target, m3_apply(&p->at.frame, v3(back[0], back[1], 0.0)));
}

void guides_locate(const tick_input *tick, const insertion_state *state, contact_points *points, hole_edge *edges) {
    for (int i = 0; i < points->guided; i++) find_touch(tick, state, points, edges, i);
    for (int i = 0; i + 1 < points->guided; i++)
        if (points->list[i].guide == points->list[i + 1].guide) keep_one_face(edges, i);
    for (int i = 0; i < points->guided; i++) find_yield(tick, points, edges, i);
}

void guides_bound(const tick_input *tick, const insertion_state *state, const contact_points *points, hole_edge *edges, contact_problem *problem, int point) {
    const contact_point *at = &points->list[point];
    const guide *g = guide_of(tick, points, point);
    const guide_contact *face = contact_of(state, points, point);
    bool holds = edges[point].touched && !at_tip(g, state_of(state, points, point), at->face);
    vec3 along = needle_along(&at->at), pressing = v3_axpy(-v3_dot(face->force, along), along, face->force);
    edges[point].rubbing = holds ? v3_norm(pressing) : 0.0;
    double friction = g->friction * edges[point].rubbing;
    problem->upper[point] = friction;
    problem->lower[point] = -friction;
    problem->viscosity[point][0] = problem->viscosity[point][1] = 0.0;
    problem->state[point] = face->friction;
}

void guides_add_compliance(const tick_input *tick, const contact_points *points, const hole_edge *edges, contact_problem *problem, int point) {
    const hole_edge *edge = &edges[point];
    int x = unknown(problem->count, point, 0), along = unknown(problem->count, point, 2);
    bool touched = edge->touched; /* if the needle does not touch the edge, the point is decoupled and bears no force */
    problem->compliance[x][x] += touched ? edge->lateral[0] : 1.0;
    problem->compliance[x][x + 1] += touched ? edge->lateral[1] : 0.0;
    problem->compliance[x + 1][x + 1] += touched ? edge->lateral[2] : 1.0;
    problem->compliance[along][along] += touched ? 1.0 / guide_of(tick, points, point)->stiffness : 1.0;
}

void guides_close_gap(const hole_edge *edges, contact_problem *problem, int point) {
    if (edges[point].touched) return;
    for (int a = 0; a < 3; a++) problem->gap[unknown(problem->count, point, a)] = 0.0;
}

void guides_take(insertion_state *state, const contact_points *points, const hole_edge *edges, const contact_problem *problem, int point) {
    const contact_point *at = &points->list[point];
    guide_contact *face = &state->guides[at->guide].faces[at->face];
    face->touching = edges[point].touched;
    face->slip = problem->slip[point];
    face->friction = problem->state[point];
}

bool guides_agree(const contact_points *points, const hole_edge *edges) {
    for (int i = 0; i < points->guided; i++)
        if (!edges[i].agrees) return false;
    return true;
}
