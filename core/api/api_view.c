/* Implements trocar/view.h for both simulations and pictures. */
#include <string.h>

#include "api/ticking.h"
#include "api/view.h"

const trocar_view *trocar_sim_view(const trocar_sim *sim) { return &sim->view; }
const trocar_view *trocar_picture_view(const trocar_picture *picture) { return &picture->view; }

static const insertion_state *state_at(const trocar_view *view, int needle) {
    return view->sim ? state_of_needle(view->sim, needle, NULL) : &view->picture->states[needle];
}

/* Returns NULL if there is no such needle. */
static const insertion_state *state_of(const trocar_view *view, int needle) { return has_needle(view->model, needle) ? state_at(view, needle) : NULL; }

static const seed_list *seeds_in(const trocar_view *view) { return view->sim ? &view->sim->seeds : &view->picture->seeds; }

/* Returns NULL if the scene has no probe. */
static const shown_probe *probe_in(const trocar_view *view) { return view->sim ? shown_probe_of(view->sim) : &view->picture->probe; }

double trocar_view_time(const trocar_view *view) { return view->sim ? view->sim->rounds.time : view->picture->time; }

/* ---- needles ---- */

trocar_pose trocar_view_base(const trocar_view *view, int needle) {
    if (!has_needle(view->model, needle)) return pose_out((pose){.orientation = {1, 0, 0, 0}});
    return pose_out(view->sim ? base_of_needle(view->sim, needle) : view->picture->bases[needle]);
}

int trocar_view_centreline(const trocar_view *view, int needle, double *joints, int room) {
    const insertion_state *state = state_of(view, needle);
    return state ? centreline_of(view->model, state, joints, room) : 0;
}

double trocar_view_tip_lead(const trocar_view *view, int needle) {
    const insertion_state *state = state_of(view, needle);
    return state ? state->tip_lead : 0.0;
}

double trocar_view_needle_energy(const trocar_view *view, int needle) {
    const insertion_state *state = state_of(view, needle);
    return state ? needle_energy(&view->model->parts.needle, &state->needle) : 0.0;
}

int trocar_view_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(view, needle);
    return state ? contacts_of(view->model, state, contacts, room) : 0;
}

int trocar_view_pending_contacts(const trocar_view *view, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(view, needle);
    return state ? pending_contacts_of(view->model, state, contacts, room) : 0;
}

int trocar_view_hole(const trocar_view *view, int needle, int guide) {
    const insertion_state *state = state_of(view, needle);
    if (!state || guide < 0 || guide >= view->model->parts.config.guide_count) return TROCAR_NO_HOLE;
    const guide_state *s = &state->guides[guide];
    return s->passage == GUIDE_IN_HOLE ? s->hole : s->passage == GUIDE_MISSED ? TROCAR_MISSED_HOLE : TROCAR_NO_HOLE;
}

int trocar_view_tracks(const trocar_view *view, int needle, trocar_track_point *points, int room) {
    const insertion_state *state = state_of(view, needle);
    return state ? tracks_of(state, points, room) : 0;
}

/* ---- seeds, probe, tissue ---- */

int trocar_view_seeds(const trocar_view *view, trocar_seed *seeds, int room) {
    const seed_list *list = seeds_in(view);
    for (int i = 0; i < list->count && i < room; i++) {
        const seed *s = &list->seeds[i];
        seeds[i] = (trocar_seed){.tet = s->tet, .needle = s->needle, .guide = s->guide, .hole = s->hole, .strand = s->strand};
        store_vec3(s->at, seeds[i].position);
        store_vec3(s->direction, seeds[i].direction);
        memcpy(seeds[i].weights, s->weights, sizeof s->weights);
    }
    return list->count;
}

int trocar_view_pending_seeds(const trocar_view *view, int needle) {
    return has_needle(view->model, needle) ? seeds_pending(needle, seeds_in(view)) : 0;
}

trocar_probe trocar_view_probe(const trocar_view *view) {
    const shown_probe *shown = probe_in(view);
    return shown ? shown->output : (trocar_probe){.placed = 0};
}

/* Returns the tissue's inverse with the current moduli. */
static inverse *inverse_in(const trocar_view *view) {
    if (!view->sim) return view->picture->mixed;
    const elasticity *e = &view->sim->elasticity;
    inverse_mix(view->sim->shown, e->from.parts->inverse, e->to.parts->inverse, elasticity_weight(e));
    return view->sim->shown;
}

trocar_status trocar_view_displacements(const trocar_view *view, double *displacements, trocar_error *error) {
    trocar_error ignored;
    const insertion_state *states[MAX_NEEDLES];
    vec3 added[MAX_CONTACTS];
    for (int i = 0; i < view->model->parts.config.needle_count; i++) states[i] = state_at(view, i);
    return field_of(view->model, inverse_in(view), states, probe_in(view), view->scratch, (vec3 *)(void *)displacements, added, error ? error : &ignored);
}
