#include "insertion/tip/prefetch.h"

#include <string.h>

#include "insertion/laws/creep.h"

static const double LINE_OFFSET = 1e-3; /* m: a needle's line counts as new if it has moved sideways by more than this. Cost limit */
static const double LINE_TURN = 0.02; /* rad: a needle's line counts as new if it has turned by more than this. Cost limit */
static const line_tolerance SAME_LINE = {1e-9, 1e-9}; /* m and rad: lines that differ by less are the same. Rounding tolerance */
static const double ABOUT_TO_TOUCH = 2e-3; /* m: if the needle is closer to the skin than this, the requested line must be exact, so that the insertion does not
                                              depend on how the needle moved before. Chosen by judgement */
static const double NEAR_FACE = 1e-7; /* m: surfaces closer than this count as touching. Rounding tolerance */
static const double WAY_IN = 1.25; /* ratio: length of the path requested into a body, relative to `prefetch_distance`. Chosen by judgement */
enum { AHEAD = 16 }; /* elements: most requested ahead of the tip. Cost limit */
enum { BEHIND = 4 }; /* contacts: those behind the tip whose elements are requested. Cost limit */
enum { AROUND_EDGE = 32 }; /* elements: most around one edge; about five are usual, and a poor mesh has twenty. Cost limit */

typedef struct {
    int count, needed;       /* number of nodes, and how many of them (the first ones) are indispensable, as in remesh_request */
    int nodes[MAX_WINDOW];
    int piece_count;
    line_in_tet pieces[MAX_PIECES];
    line_tolerance tolerance; /* how much a line may differ from one requested before and still reuse it */
} wanted_tissue;

static bool contains(const int *nodes, int count, int node) {
    for (int i = 0; i < count; i++)
        if (nodes[i] == node) return true;
    return false;
}

/* Adds the corners of an element that are not in the list yet. Searches for all four at once. */
static void add_tet(const mesh *m, int tet, wanted_tissue *list) {
    int corners[4], found[4] = {0};
    memcpy(corners, m->tets[tet], sizeof corners);
    for (int i = 0; i < list->count; i++)
        for (int c = 0; c < 4; c++) found[c] |= list->nodes[i] == corners[c];
    for (int c = 0; c < 4; c++)
        if (!found[c] && list->count < MAX_WINDOW) list->nodes[list->count++] = corners[c];
}

static void add_piece(int tet, vec3 x, vec3 direction, wanted_tissue *list) {
    for (int i = 0; i < list->piece_count; i++)
        if (list->pieces[i].tet == tet) return;
    if (list->piece_count < MAX_PIECES) list->pieces[list->piece_count++] = (line_in_tet){tet, x, v3_unit(direction)};
}

/* A straight path through elements and across gaps. */
typedef struct {
    int tet;                 /* current element; -1 outside the tissue */
    vec3 x, direction;       /* x, m: current point; direction: unit vector */
    bool back;               /* the direction points back along the track */
    double remaining;        /* m, length left */
    int steps;               /* elements crossed so far */
} straight_way;

/* Continues the path where it meets tissue again. Returns false if it does not. */
static bool cross_gap(const mesh *m, straight_way *way) {
    surface_hit next = mesh_enter(m, v3_axpy(-NEAR_FACE, way->direction, way->x), v3_axpy(way->remaining, way->direction, way->x));
    if (!next.hit) return false;
    way->tet = next.tet;
    way->x = next.point;
    way->remaining -= next.fraction * way->remaining;
    return true;
}

/* Adds the elements along the path, up to its end. In the first `measured` of them, requests that the mesh's resolution be measured along this line. The caller
   can then make the path longer and continue it. */
static void add_way(const mesh *m, straight_way *way, int measured, wanted_tissue *list) {
    for (; way->steps < AHEAD; way->steps++) {
        double chord;
        if (way->tet < 0 && !cross_gap(m, way)) return;
        add_tet(m, way->tet, list);
        if (way->steps < measured) add_piece(way->tet, way->x, way->back ? v3_scale(-1.0, way->direction) : way->direction, list);
        int face = mesh_exit(m, way->tet, way->x, way->direction, &chord);
        if (face < 0 || chord > way->remaining) return;
        way->x = v3_axpy(chord, way->direction, way->x);
        way->remaining -= chord;
        way->tet = m->neighbours[way->tet][face];
    }
}

static void add_surroundings(const mesh *m, int tet, wanted_tissue *list) {
    add_tet(m, tet, list);
    for (int f = 0; f < 4; f++)
        if (m->neighbours[tet][f] >= 0) add_tet(m, m->neighbours[tet][f], list);
}

/* Adds the elements behind the outer faces that share an edge with this face, because the tip may slide onto them. Goes around each edge from element to
   element until it reaches the outer surface again. */
static void add_beside(const mesh *m, int tet, int face, wanted_tissue *list) {
    for (int c = 0; c < 4; c++) {
        if (c == face) continue;
        int at = tet, exit = c, last = m->tets[tet][face], sum = 0; /* `last`: the corner of the crossed face that is not on the edge */
        for (int k = 0; k < 4; k++) sum += k == face || k == c ? 0 : m->tets[tet][k]; /* sum of the indices of the edge's two nodes */
        for (int step = 0; step < AROUND_EDGE && m->neighbours[at][exit] >= 0; step++) {
            at = m->neighbours[at][exit];
            int all = 0;
            for (int k = 0; k < 4; k++) {
                all += m->tets[at][k];
                if (m->tets[at][k] == last) exit = k;
            }
            last = all - sum - last;
        }
        add_tet(m, at, list);
    }
}

/* Adds the elements along the track from x back to the last contact node (not counting the last `skipped` nodes), or back to the entry. Returns the point
   reached. */
static vec3 add_stretch_back(const mesh *m, const insertion_state *state, int tet, vec3 x, int skipped, wanted_tissue *list) {
    int k = contacts_passed(state) - 1 - skipped;
    const shaft_contact *contact = k >= 0 ? &state->contacts[state->refined.order[k]] : NULL;
    vec3 to = contact ? v3_sub(contact->track, contact->beside) : state->entry, back = v3_sub(to, x);
    double length = v3_norm(back);
    if (length == 0.0) return to;
    straight_way way = {.tet = tet, .x = x, .direction = v3_scale(1.0 / length, back), .back = true, .remaining = length};
    add_way(m, &way, AHEAD, list);
    return to;
}

/* Adds the track behind the tip: the elements of the last few contact nodes, and those between the tip, the last node and the one before. */
static void add_track(const mesh *m, const insertion_state *state, wanted_tissue *list) {
    vec3 last = add_stretch_back(m, state, state->tip.place.tet, state->tip.place.nominal, 0, list);
    int passed = contacts_passed(state);
    if (passed > 0) add_stretch_back(m, state, state->refined.nodes[state->refined.order[passed - 1]].tet, last, 1, list);
    for (int k = passed - 1; k >= 0 && k >= passed - BEHIND; k--) {
        const added_node *node = &state->refined.nodes[state->refined.order[k]];
        add_tet(m, node->tet, list);
        add_piece(node->tet, node->line.point, node->line.direction, list);
        if (added_on_face(node) && node->across_tet >= 0) add_piece(node->across_tet, node->line.point, node->line.direction, list);
    }
}

/* Adds the elements along the needle's path into a body ahead, from the entry point to about `reach` from the needle's end. */
static void add_way_in(const mesh *m, surface_hit hit, vec3 direction, double reach, wanted_tissue *list) {
    straight_way way = {.tet = hit.tet, .x = hit.point, .direction = direction, .remaining = reach * (WAY_IN - hit.fraction)};
    if (hit.hit) add_way(m, &way, 1, list);
}

/* Returns where the end of a needle in the air is relative to the tissue at rest: as far from the surface as it really is from the displaced surface. */
static vec3 end_before_tissue(const insertion_model *model, const insertion_state *state) {
    vec3 end = state->needle.joints[model->needle->given.segments];
    return isnan(state->surface.x) ? end : v3_sub(end, state->surface);
}

static wanted_tissue wanted_nodes(const insertion_model *model, const insertion_state *state) {
    const mesh *m = model->mesh;
    int n = model->needle->given.segments;
    vec3 direction = q_axis(state->needle.frames[n - 1]), end = state->needle.joints[n];
    double reach = model->settings.prefetch_distance;
    wanted_tissue list = {.count = 0, .piece_count = 0, .tolerance = SAME_FIELD};
    if (state->tip.place.phase == TIP_FREE) { /* request the path from where the needle will enter */
        end = end_before_tissue(model, state);
        surface_hit hit = mesh_enter(m, end, v3_axpy(reach, direction, end));
        if (!hit.hit) { /* the needle's end is in a dent */
            hit = mesh_enter(m, v3_axpy(-model->needle->given.length, direction, end), end);
            hit.fraction = 0.0;
        }
        if (hit.hit) add_tet(m, hit.tet, &list);
        list.needed = list.count;
        if (hit.hit && hit.fraction * reach < ABOUT_TO_TOUCH) list.tolerance = SAME_LINE;
        add_way_in(m, hit, direction, reach, &list);
        return list;
    }
    double weights[4];
    int moved = refinement_element(m, &state->refined, state->refined.count, state->tip.place.tet, state->tip.place.nominal, weights);
    add_surroundings(m, moved, &list); /* the element that contains the tip in the refined mesh */
    if (moved != state->tip.place.tet) add_surroundings(m, state->tip.place.tet, &list); /* and the one that contains it in the nominal mesh */
    if (state->tip.place.phase == TIP_INSIDE && state->tip.place.depth == 0.0) add_beside(m, state->tip.place.tet, state->tip.barrier.face, &list);
    straight_way way = {.tet = state->tip.place.tet, .x = state->tip.place.nominal, .direction = tip_way(&state->tip.place, direction), .remaining = model->settings.gradient_span};
    add_way(m, &way, AHEAD, &list);
    surface_hit next = {.hit = false};
    if (state->tip.place.phase == TIP_BEYOND) next = mesh_enter(m, end, v3_axpy(reach, direction, end));
    if (next.hit) add_tet(m, next.tet, &list);
    list.needed = list.count;
    add_track(m, state, &list);
    way.remaining += reach - model->settings.gradient_span;
    add_way(m, &way, 0, &list);
    add_way_in(m, next, direction, reach, &list);
    return list;
}

static bool same_contacts(const refinement *a, const refinement *b) {
    if (a->count != b->count) return false;
    for (int i = 0; i < a->count; i++)
        if (a->order[i] != b->order[i] || a->nodes[a->order[i]].id != b->nodes[b->order[i]].id) return false;
    return true;
}

static void copy_contacts(const refinement *from, refinement *to) {
    to->count = from->count;
    for (int i = 0; i < from->count; i++) {
        to->order[i] = from->order[i];
        to->nodes[from->order[i]] = from->nodes[from->order[i]];
    }
}

static void copy_residual_loads(const residual_loads *from, residual_loads *to) {
    to->time = from->time;
    to->count = from->count;
    memcpy(to->loads, from->loads, (size_t)from->count * sizeof *from->loads);
}

static bool window_suffices(const remesh_request *request, const wanted_tissue *wanted) {
    for (int i = 0; i < wanted->count; i++) {
        int among = i < wanted->needed ? request->needed : request->window_count;
        bool same_place = i < among && request->window[i] == wanted->nodes[i]; /* the usual case */
        if (!same_place && !contains(request->window, among, wanted->nodes[i])) return false;
    }
    for (int i = 0; i < wanted->piece_count; i++)
        if (!request_line(request, &wanted->pieces[i], wanted->tolerance)) return false;
    return true;
}

/* Requests lines unchanged if they were requested before, so that the worker does not have to measure them again. */
static void copy_pieces(wanted_tissue *wanted, remesh_request *request) {
    for (int i = 0; i < wanted->piece_count; i++) {
        const line_in_tet *known = request_line(request, &wanted->pieces[i], wanted->tolerance);
        if (known) wanted->pieces[i] = *known;
    }
    request->piece_count = wanted->piece_count;
    memcpy(request->pieces, wanted->pieces, (size_t)wanted->piece_count * sizeof *wanted->pieces);
}

/* Finds the material point at the tip and the direction of the needle's end, in which the tip will probably move. */
static void find_line(const insertion_model *model, const insertion_state *state, vec3 *tip, vec3 *direction) {
    int n = model->needle->given.segments;
    *tip = state->tip.place.phase == TIP_INSIDE ? state->tip.place.nominal : state->tip.place.phase == TIP_FREE ? end_before_tissue(model, state) : state->needle.joints[n];
    *direction = q_axis(state->needle.frames[n - 1]);
}

static bool same_line(const remesh_request *request, vec3 tip, vec3 direction) {
    vec3 aside = v3_cross(request->direction, v3_sub(tip, request->tip));
    return v3_norm(aside) < LINE_OFFSET && v3_norm(v3_sub(direction, request->direction)) < LINE_TURN;
}

void prefetch_request(const insertion_model *model, insertion_state *state) {
    wanted_tissue wanted = wanted_nodes(model, state);
    remesh_request *request = &state->request;
    bool same = same_contacts(&request->wanted, &state->refined);
    vec3 tip, direction;
    find_line(model, state, &tip, &direction);
    bool suffices = same && window_suffices(request, &wanted) && same_line(request, tip, direction);
    if (suffices && !creep_has_new_residuals(&state->memory)) return;
    request->serial++;
    request->tip = tip;
    request->direction = direction;
    copy_residual_loads(&state->memory.residual, &request->residual_loads);
    state->memory.residual_added = 0.0;
    if (!same) copy_contacts(&state->refined, &request->wanted);
    copy_pieces(&wanted, request);
    request->window_count = wanted.count;
    request->needed = wanted.needed;
    memcpy(request->window, wanted.nodes, (size_t)wanted.count * sizeof *wanted.nodes);
}
