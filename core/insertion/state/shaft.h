/* The shaft in the tissue: the share of it that each contact represents, and the tissue's resistance to that share's motion.
   See docs/mechanics.md, "What a contact is". */
#ifndef TROCAR_SHAFT_H
#define TROCAR_SHAFT_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The share of the track that a point on the shaft represents. */
typedef struct {
    double from, to;         /* m, depths at which the share begins and ends */
} shaft_share;

/* The tissue's resistance to the motion of a share of the shaft, summed over the regions that it crosses. */
typedef struct {
    double kinetic, excess;      /* N, limit of kinetic friction, and difference between the static and the kinetic limit */
    double viscous;              /* N s/m, viscous friction */
    double lateral, axial;       /* N/m, length of shaft divided by the material factor of its local compliance to a line force (local_line_stiffness) */
    double stiffening;           /* mean of the regions' stiffening coefficients, weighted by axial stiffness: exact to third order in the force */
} shaft_resistance;

/* Share of active contact number k, counted from the base: it extends halfway to each neighbour. If `tip` is true, the tip follows the last contact (its k
   is the number of active contacts) and has the rest of the shaft. RT */
shaft_share shaft_share_of(const insertion_state *state, int k, bool tip);

/* Like shaft_share_of, but must be called for consecutive shares, from k = 0. `border` (m of depth), initially 0, is where this share begins; the call
   advances it to where the next share begins. RT */
shaft_share shaft_next_share(const insertion_state *state, int k, bool tip, double *border);

/* The piece of shaft in a share: the share of the contact in `slot`, or that of the tip. RT */
shaft_piece shaft_piece_of_contact(const insertion_state *state, int slot, shaft_share share);
shaft_piece shaft_piece_of_tip(const insertion_state *state, shaft_share share);

/* Friction and stiffness of the tissue along a share of the track, summed over the strata in the share. RT */
shaft_resistance shaft_resistance_of(const insertion_model *model, const insertion_state *state, shaft_share part);

/* Friction limit (N) after sliding by `slid` (m): static friction falls to kinetic friction by slip weakening, at any rate of slip. RT */
static inline double shaft_friction_limit(const insertion_model *model, const shaft_resistance *shaft, double slid) {
    return shaft->kinetic + shaft->excess * exp(-slid / model->settings.weakening_distance);
}

/* State of the shaft in unsheared tissue at this depth, for a tip at the same depth. RT */
static inline shaft_hold shaft_at_rest(const insertion_model *model, double depth) {
    return (shaft_hold){.origin = model->needle->given.length - depth, .roll = {.anchor = NAN}};
}

#endif
