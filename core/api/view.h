/* Converts internal states to the structs of trocar.h. Uses no handles except the model, which is immutable. */
#ifndef TROCAR_VIEW_H
#define TROCAR_VIEW_H

#include "api/api.h"

static inline void store_vec3(vec3 v, double out[3]) {
    out[0] = v.x;
    out[1] = v.y;
    out[2] = v.z;
}

trocar_pose pose_out(pose base);

/* Convert values that a scene may omit. Return 1, or 0 without writing if the scene omits the value. */
int start_out(pose start, trocar_pose *out);
int transform_out(const double matrix[16], double out[16]);

/* Implement trocar_view_contacts, trocar_view_pending_contacts, trocar_view_tracks and trocar_view_centreline for the given state. RT */
int contacts_of(const trocar_model *model, const insertion_state *state, trocar_contact *contacts, int room);
int pending_contacts_of(const trocar_model *model, const insertion_state *state, trocar_contact *contacts, int room);
int tracks_of(const insertion_state *state, trocar_track_point *points, int room);
int centreline_of(const trocar_model *model, const insertion_state *state, double *joints, int room);

/* Adds the forces of the probe, and of all needles except the first, to the forces `nominal` on the mesh nodes (contact nodes excluded). `states` has one
   entry per needle of the model. */
void spread_others(const trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 *nominal);

/* Computes the displacements of the mesh nodes (`nominal`) and of the first needle's contact nodes (`added`). Allocates *scratch if it is NULL; returns
   NO_MEMORY if that fails. */
trocar_status field_of(const trocar_model *model, inverse *inv, const insertion_state *const states[], const shown_probe *probe, vec3 **scratch, vec3 *nominal, vec3 *added,
                       trocar_error *why);

#endif
