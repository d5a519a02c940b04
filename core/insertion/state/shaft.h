/* The shaft in the tissue: how much of it each contact stands for, and how strongly the tissue resists that length's motion. See docs/mechanics.md, "What a
   contact is". */
#ifndef TROCAR_SHAFT_H
#define TROCAR_SHAFT_H

#include "insertion/model/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The length of track that a point on the shaft stands for (its tributary length). */
typedef struct {
    double from, to;         /* m, depths at which the share begins and ends */
} shaft_share;

/* The tissue's resistance to the motion of a share of the shaft, summed over the regions that the share crosses. */
typedef struct {
    double kinetic, excess;      /* N, kinetic friction limit, and static minus kinetic limit */
    double viscous;              /* N s/m, viscous friction */
    double lateral, axial;       /* N/m, length of shaft divided by the material factor of its local compliance to a line force (local_line_stiffness) */
    double stiffening;           /* mean of the regions' stiffening coefficients, weighted by axial stiffness, which is exact to third order in the force */
} shaft_resistance;

/* Returns the share of active contact k, counted from the base, which extends halfway to each neighbour. If `tip` is true, the tip counts as the point after
   the last contact, and its share is the rest of the shaft. RT */
shaft_share shaft_share_of(const insertion_state *state, int k, bool tip);

/* Like shaft_share_of, but faster when called for consecutive shares, starting with k = 0. `border` (m of depth) is where this share begins, initially 0; the
   call advances it to where the next one begins. RT */
shaft_share shaft_next_share(const insertion_state *state, int k, bool tip, double *border);

/* Returns the piece of shaft in a share: that of the contact in `slot`, or that of the tip. RT */
shaft_piece shaft_piece_of_contact(const insertion_state *state, int slot, shaft_share share);
shaft_piece shaft_piece_of_tip(const insertion_state *state, shaft_share share);

/* Returns the tissue's friction and stiffness along a share, summed over the strata it crosses. RT */
shaft_resistance shaft_resistance_of(const insertion_model *model, const insertion_state *state, shaft_share part);

/* Returns the friction limit (N) after sliding by `slid` (m). Static friction weakens to kinetic friction with the distance slid, at any speed. RT */
static inline double shaft_friction_limit(const insertion_model *model, const shaft_resistance *shaft, double slid) {
    return shaft->kinetic + shaft->excess * exp(-slid / model->settings.weakening_distance);
}

/* Returns the state of a shaft in unsheared tissue at this depth, with the tip at the same depth. RT */
static inline shaft_hold shaft_at_rest(const insertion_model *model, double depth) {
    return (shaft_hold){.origin = model->needle->given.length - depth, .roll = {.anchor = NAN}};
}

#endif
