/* The shaft in the tissue: which part of it each contact stands for, and what that part meets. See docs/mechanics.md, "What a contact is". */
#ifndef TROCAR_SHAFT_H
#define TROCAR_SHAFT_H

#include "insertion/state/insertion_model.h"
#include "insertion/state/insertion_state.h"

/* The part of the track that a point of the shaft stands for. */
typedef struct {
    double from, to;         /* m of depth */
} shaft_share;

/* What a part of the shaft meets in the regions that it lies in. */
typedef struct {
    double kinetic, excess;      /* N, friction limit after sliding far, and how much higher it is at rest */
    double viscous;              /* N s/m, viscous friction */
    double lateral, axial;       /* m of shaft over the local compliance of a line force per logarithm, N/m */
    double stiffening;           /* mean of the regions', by their axial stiffness: exact to the third order in the force */
} shaft_resistance;

/* The part of active contact number k from the base: half way to its neighbours. With `tip`, the tip is the last of them, after the
   contacts (k: how many they are), and has the rest. RT */
shaft_share shaft_share_of(const insertion_state *state, int k, bool tip);

/* The same, one after the other from k = 0: border, m of depth, is where it begins, at first 0, and becomes where the next one does. RT */
shaft_share shaft_next_share(const insertion_state *state, int k, bool tip, double *border);

/* Friction and stiffness of the tissue along a part of the track, layer by layer. RT */
shaft_resistance shaft_resistance_of(const insertion_model *model, const insertion_state *state, shaft_share part);

/* Friction limit after sliding `slid` (m), N: static falls to kinetic by slip weakening, independent of the rate. RT */
static inline double shaft_friction_limit(const insertion_model *model, const shaft_resistance *shaft, double slid) {
    return shaft->kinetic + shaft->excess * exp(-slid / model->settings.weakening_distance);
}

/* A shaft that the tissue at this depth does not shear, where the tip is at that depth. RT */
static inline shaft_hold shaft_at_rest(const insertion_model *model, double depth) {
    return (shaft_hold){.origin = model->needle->given.length - depth, .roll = {.anchor = NAN}};
}

#endif
