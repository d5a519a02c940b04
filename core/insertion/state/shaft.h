/* The shaft in the tissue: the share that each contact represents, and the resistance that it meets. See docs/mechanics.md, "What a contact is". */
#ifndef TROCAR_SHAFT_H
#define TROCAR_SHAFT_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The share of the track that a point of the shaft represents. */
typedef struct {
    double from, to;         /* m of depth */
} shaft_share;

/* Resistance to a share of the shaft in its regions. */
typedef struct {
    double kinetic, excess;      /* N, kinetic friction limit, and excess of the static limit */
    double viscous;              /* N s/m, viscous friction */
    double lateral, axial;       /* N/m, length of shaft over the local compliance to a line force per logarithm */
    double stiffening;           /* mean of the regions' stiffening, weighted by axial stiffness: exact to third order in the force */
} shaft_resistance;

/* Share of active contact number k from the base: halfway to its neighbours. With `tip`, the tip follows the last contact (k: number of active contacts) and
   has the rest. RT */
shaft_share shaft_share_of(const insertion_state *state, int k, bool tip);

/* Like shaft_share_of, for one share after the other from k = 0. `border` (m of depth) is the beginning of this share, initially 0; it is advanced to the
   beginning of the next. RT */
shaft_share shaft_next_share(const insertion_state *state, int k, bool tip, double *border);

/* Friction and stiffness of the tissue along a share of the track, summed over its strata. RT */
shaft_resistance shaft_resistance_of(const insertion_model *model, const insertion_state *state, shaft_share part);

/* Friction limit after sliding by `slid` (m), N: static friction falls to kinetic by slip weakening, independent of the rate. RT */
static inline double shaft_friction_limit(const insertion_model *model, const shaft_resistance *shaft, double slid) {
    return shaft->kinetic + shaft->excess * exp(-slid / model->settings.weakening_distance);
}

/* Shaft in unsheared tissue at this depth, for a tip at the same depth. RT */
static inline shaft_hold shaft_at_rest(const insertion_model *model, double depth) {
    return (shaft_hold){.origin = model->needle->given.length - depth, .roll = {.anchor = NAN}};
}

#endif
