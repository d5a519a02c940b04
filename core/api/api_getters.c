/* trocar.h: getters of a simulation. */
#include "api/ticking.h"
#include "api/view.h"

/* State of a needle; NULL if `needle` is out of range. */
static const insertion_state *state_of(const trocar_sim *sim, int needle) { return has_needle(sim->model, needle) ? state_of_needle(sim, needle, NULL) : NULL; }

int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? contacts_of(sim->model, state, contacts, room) : 0;
}

int trocar_sim_pending_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? pending_contacts_of(sim->model, state, contacts, room) : 0;
}

int trocar_sim_hole(const trocar_sim *sim, int needle, int guide) {
    const insertion_state *state = state_of(sim, needle);
    if (!state || guide < 0 || guide >= sim->model->parts.config.guide_count) return TROCAR_NO_HOLE;
    const guide_state *s = &state->guides[guide];
    return s->passage == GUIDE_IN_HOLE ? s->hole : s->passage == GUIDE_MISSED ? TROCAR_MISSED_HOLE : TROCAR_NO_HOLE;
}

int trocar_sim_tracks(const trocar_sim *sim, int needle, trocar_track_point *points, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? tracks_of(state, points, room) : 0;
}

int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? centreline_of(sim->model, state, joints, room) : 0;
}

trocar_pose trocar_sim_base(const trocar_sim *sim, int needle) {
    if (!has_needle(sim->model, needle)) return pose_out((pose){.orientation = {1, 0, 0, 0}});
    const insertion_state *state = state_of_needle(sim, needle, NULL);
    pose base = sim->needles[needle].given;
    if (state != &sim->needles[needle].state) return pose_out(state->needle.base);
    base.position = v3_add(base.position, state->base_shift);
    return pose_out(base);
}

double trocar_sim_tip_lead(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of(sim, needle);
    return state ? state->tip_lead : 0.0;
}

double trocar_sim_needle_energy(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of(sim, needle);
    return state ? needle_energy(&sim->model->parts.needle, &state->needle) : 0.0;
}

trocar_status trocar_sim_displacements(trocar_sim *sim, double *displacements, trocar_error *error) {
    trocar_error ignored;
    const insertion_state *states[MAX_NEEDLES];
    vec3 added[MAX_CONTACTS];
    for (int i = 0; i < sim->needle_count; i++) states[i] = state_of_needle(sim, i, NULL);
    return field_of(sim->model, states, shown_probe_of(sim), &sim->field_scratch, (vec3 *)(void *)displacements, added, error ? error : &ignored);
}
