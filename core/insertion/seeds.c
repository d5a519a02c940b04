#include "insertion/seeds.h"

#include <math.h>
#include <string.h>

#include "insertion/state/strata.h"
#include "insertion/tip/tip_walk.h"

static const double ON_FACE = -1e-6; /* dimensionless: a point with a barycentric weight below this is outside the element. Rounding tolerance */

/* ---- the track, from the tip back ---------------------------------------------------------------------------------------- */

/* A position on the track. */
typedef struct {
    double depth;            /* m */
    vec3 at;                 /* m, nominal */
    int tet;
    int next;                /* index, counted from the base, of the next contact towards the entry; -1 if the entry is next */
} track_site;

/* Where the track towards the entry bends, ends or is interrupted. */
typedef struct {
    double depth;            /* m */
    vec3 at;                 /* m, nominal */
    bool contact;            /* a contact: the track goes on in another direction */
    const stratum *surface;  /* a surface on which the tissue slides: the track goes on at another place; NULL if this is not one */
} track_stop;

/* Returns the next stop towards the entry. The entry itself, which may be that of the tip's body, is neither a contact nor a surface. */
static track_stop next_stop(const insertion_state *state, const track_site *site) {
    const shaft_contact *contact = site->next >= 0 ? &state->contacts[state->refined.order[site->next]] : NULL;
    double entry = tip_entry_depth(state);
    int gap = last_gap(state), sliding = last_sliding(state, site->depth);
    track_stop stop = {entry, gap >= 0 ? state->strata[gap + 1].point : state->entry, false, NULL};
    if (contact && contact->depth >= entry) stop = (track_stop){contact->depth, v3_sub(contact->track, contact->beside), true, NULL};
    if (sliding < 0 || state->strata[sliding].depth <= stop.depth) return stop;
    const stratum *surface = &state->strata[sliding];
    return (track_stop){surface->depth, surface->point, false, surface};
}

/* Moves a site that has reached a stop past it. Returns false at the entry. */
static bool pass_stop(const track_stop *stop, track_site *site) {
    site->depth = stop->depth;
    if (stop->contact) site->next--;
    if (stop->surface) *site = (track_site){stop->depth - FACE_CLEARANCE, stop->surface->left, stop->surface->left_tet, site->next};
    return stop->contact || stop->surface;
}

/* Moves the site back along the track to this depth, which must be in the tip's body. */
static void go_back(const insertion_model *model, const insertion_state *state, double depth, track_site *site) {
    while (site->depth > depth) {
        track_stop stop = next_stop(state, site);
        double length = site->depth - stop.depth, wanted = site->depth - depth;
        bool reached = length <= wanted;
        vec3 target = reached ? stop.at : v3_axpy(wanted / length, v3_sub(stop.at, site->at), site->at);
        site->tet = follow_line(model->mesh, site->tet, &site->at, target);
        site->depth = depth;
        if (!reached || !pass_stop(&stop, site)) return;
    }
}

/* Finds where a seed lies whose distal end is at this depth. Searches back from `site`, which must be at least as deep, and leaves `site` at the seed's
   proximal end. Returns false if part of the seed would be outside the tissue. */
static bool find_place(const insertion_model *model, const insertion_state *state, double depth, double length, track_site *site, seed *s) {
    go_back(model, state, depth, site);
    vec3 distal = site->at;
    go_back(model, state, depth - 0.5 * length, site);
    s->at = site->at;
    s->tet = site->tet;
    mesh_barycentric(model->mesh, s->tet, s->at, s->weights);
    go_back(model, state, depth - length, site);
    s->direction = v3_unit(v3_sub(distal, site->at));
    return fmin(fmin(s->weights[0], s->weights[1]), fmin(s->weights[2], s->weights[3])) >= ON_FACE;
}

/* ---- dropping ------------------------------------------------------------------------------------------------------------- */

double seeds_strand_length(const seed_size *size, int count, double spacing) {
    return size->length + (count - 1) * (spacing == 0.0 ? size->spacing : spacing);
}

static int count_pending(const seed_list *list) {
    int sum = 0;
    for (int i = 0; i < MAX_NEEDLES; i++) sum += seeds_pending(i, list);
    return sum;
}

/* Records which hole the needle is in. If several guides hold the needle, the first one counts. */
static void note_hole(const insertion_model *model, const insertion_state *state, seed *s) {
    s->guide = s->hole = NO_HOLE;
    for (int i = model->guide_count - 1; i >= 0; i--)
        if (state->guides[i].passage == GUIDE_IN_HOLE) s->guide = i, s->hole = state->guides[i].hole;
}

/* Checks whatever does not depend on the track. Returns the reason why the seeds cannot be dropped, or SEEDS_ACCEPTED. */
static seed_refusal refuse(const insertion_model *model, const seed_size *size, const insertion_state *state, int needle, int count, double spacing,
                           const seed_list *list) {
    if (count < 1 || count > MAX_STRAND) return SEEDS_BAD_COUNT;
    if (!(spacing == 0.0 || (spacing >= size->length && spacing < INFINITY))) return SEEDS_BAD_SPACING;
    if (size->diameter >= 2.0 * model->needle->radius) return SEEDS_TOO_THICK;
    if (seeds_pending(needle, list) > 0) return SEEDS_PENDING;
    if (list->count + count_pending(list) + count > MAX_SEEDS) return SEEDS_FULL;
    if (state->tip.place.phase != TIP_INSIDE) return SEEDS_OUTSIDE;
    return state->tip.place.depth - tip_entry_depth(state) < seeds_strand_length(size, count, spacing) ? SEEDS_TOO_LONG : SEEDS_ACCEPTED;
}

seed_refusal seeds_drop(const insertion_model *model, const seed_size *size, const insertion_state *state, int needle, int count, double spacing, seed_list *list) {
    seed_refusal refusal = refuse(model, size, state, needle, count, spacing, list);
    if (refusal != SEEDS_ACCEPTED) return refusal;

    double pitch = spacing == 0.0 ? size->spacing : spacing;
    track_site site = {state->tip.place.depth, state->tip.place.nominal, state->tip.place.tet, contacts_passed(state) - 1};
    seed_drop drop = {.count = count};
    for (int i = 0; i < count; i++) {
        double depth = state->tip.place.depth - i * pitch;
        drop.seeds[i] = (seed){.needle = needle, .strand = i};
        note_hole(model, state, &drop.seeds[i]);
        drop.uncovered[i] = depth - size->length;
        if (!find_place(model, state, depth, size->length, &site, &drop.seeds[i])) return SEEDS_OUTSIDE;
    }
    list->drops[needle] = drop;
    return SEEDS_ACCEPTED;
}

void seeds_follow(const insertion_state *state, int needle, seed_list *list) {
    seed_drop *drop = &list->drops[needle];
    double depth = state->tip.place.phase == TIP_FREE ? -INFINITY : state->tip.place.depth;
    while (drop->placed < drop->count && depth <= drop->uncovered[drop->placed]) list->seeds[list->count++] = drop->seeds[drop->placed++];
}

void seeds_keep(int needle, seed_list *list) { list->drops[needle] = (seed_drop){.count = 0}; }

seed_refusal seeds_undo(int needle, seed_list *list) {
    if (seeds_pending(needle, list) > 0) {
        seeds_keep(needle, list);
        return SEEDS_ACCEPTED;
    }
    int last = list->count - 1;
    while (last >= 0 && list->seeds[last].needle != needle) last--;
    if (last < 0) return SEEDS_NONE;
    list->count--;
    memmove(&list->seeds[last], &list->seeds[last + 1], (size_t)(list->count - last) * sizeof *list->seeds);
    return SEEDS_ACCEPTED;
}

void seeds_clear(int needle, seed_list *list) {
    int kept = 0;
    seeds_keep(needle, list);
    for (int i = 0; i < list->count; i++)
        if (list->seeds[i].needle != needle) list->seeds[kept++] = list->seeds[i];
    list->count = kept;
}

/* ---- in the deformed tissue ----------------------------------------------------------------------------------------------- */

void seed_displaced(const mesh *m, const seed *s, const vec3 *displacement, vec3 *at, vec3 *direction) {
    vec3 corners[4], gradients[4], moved = s->at, turned = s->direction;
    mesh_corners(m, s->tet, corners);
    tet_gradients(corners, gradients);
    for (int c = 0; c < 4; c++) {
        vec3 u = displacement[m->tets[s->tet][c]];
        moved = v3_axpy(s->weights[c], u, moved);
        turned = v3_axpy(v3_dot(gradients[c], s->direction), u, turned); /* (1 + grad u) d */
    }
    *at = moved;
    *direction = v3_unit(turned);
}
