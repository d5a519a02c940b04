/* A resting needle: nobody holds it, and tissue and guides keep it in place. It responds linearly to other loads on the tissue, about the equilibrium
   in which it was left. See docs/mechanics.md, "Resting needles". */
#ifndef TROCAR_RESTING_NEEDLE_H
#define TROCAR_RESTING_NEEDLE_H

#include "insertion/state/tick_data.h"
#include "inverse/inverse_attached.h"
#include "snapshot/needle_pairs.h"

enum { MAX_MOTIONS = 5 };    /* motions of the base: all except the rotation about the needle's axis, which friction prevents */

typedef struct { vec3 shift, turn; } base_motion; /* world frame; shift, m: translation; turn, rad: rotation about the base */

/* Plain data. Forces on tissue and guides are stored like the unknowns of the contact problem: in the same order, and in the needle's frame. */
typedef struct {
    uint64_t id;             /* a new id each time the needle is left */
    insertion_state anchor;  /* equilibrium in which the needle was left */
    int point_count, unknown_count, axial_count;
    bool tip;                /* true if the last point is the tip */
    bool loaded;             /* true if `compliance` includes the effect of the needle's forces on its own stiffness */
    bool alone;              /* true if `compliance` was computed while no needle was attached, as after a change in moduli (resting_soften) */
    contact_point points[MAX_POINTS];
    attached_row rows[MAX_UNKNOWNS];
    tissue_loads places;                           /* positions of its loads on the tissue, which act at all points that are not at a guide; the forces are
                                                      not used */
    shaft_steps steps;                             /* the needle's track, divided into short steps */
    double compliance[MAX_UNKNOWNS][MAX_UNKNOWNS]; /* m/N, lower triangle: compliance of the needle with its base clamped, of the guides, and of the tissue
                                                      around the shaft */
    int motion_count;
    double motions[MAX_MOTIONS][MAX_UNKNOWNS];     /* displacement of each row under each motion of the base */
    base_motion twists[MAX_MOTIONS];                     /* motion of the base that causes each row of `motions` */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, bounds on the axial forces at the anchor */
    double anchor_force[MAX_UNKNOWNS];             /* N, forces at the anchor */
    double beside[MAX_UNKNOWNS];                   /* N, loads on the tissue that come from its memory and not from the needle's forces */
    double free_force[MAX_UNKNOWNS], free_motion[MAX_MOTIONS]; /* forces and motions in the absence of held needles */
    double force[MAX_UNKNOWNS], motion[MAX_MOTIONS];           /* current forces and motion */
    double aside[MAX_UNKNOWNS];                    /* N, change in the forces due to displacements by held needles that the mesh does not resolve */
    double fading[MAX_UNKNOWNS];                   /* N, forces of the needle's rows before the last release minus those after it (resting_set) */
    double slip[MAX_AXIAL], slid[MAX_AXIAL];       /* m, slip of the shaft since the anchor (positive: forward relative to the tissue), and total distance
                                                      slid */
} resting_needle;

/* The worker's scratch for the linearisation. */
typedef struct {
    insertion_workspace workspace;
    insertion_state state;
    double matrix[MAX_UNKNOWNS][MAX_UNKNOWNS];
} resting_scratch;

/* Linearises about `state`, which must be an equilibrium. tick->snapshot must contain the needle's rows of `inv` in its current state. BAD_INPUT if the
   needle touches no tissue. Allocates. */
trocar_status resting_linearise(const tick_input *tick, const insertion_state *state, inverse *inv, resting_scratch *scratch, resting_needle *r,
                                trocar_error *why);

/* Recomputes `compliance` about the anchor after the moduli have changed. tick->snapshot must contain the needle's rows of `inv`, to which nothing may be
   attached. */
trocar_status resting_soften(const tick_input *tick, inverse *inv, resting_scratch *scratch, resting_needle *r, trocar_error *why);

/* Stores in r->fading the forces that the rows had in `held`, the state in which the hand released the needle. To be called after resting_linearise. */
void resting_bore(const insertion_model *model, const insertion_state *held, resting_needle *r);

/* Computes the motion of the base that makes the base's wrench vanish if nothing slides; its component along the needle is multiplied by `size`, and all
   components are limited. To be called after resting_linearise. NUMERIC if needle and tissue are unstable. */
trocar_status resting_release_step(const resting_needle *r, double size, resting_scratch *scratch, base_motion *step, trocar_error *why);
pose pose_moved(pose base, base_motion step);

/* Returns the row's place as an index of `places`, or -1 if the row is at a guide. */
int resting_place(const resting_needle *r, int u);

/* For each place, computes the displacement per unit force on a piece of another needle's shaft, as far as the mesh does not resolve it: lacks[places.count],
   m/N. *any: false if all of it is zero; `lacks` is not set then. */
trocar_status resting_lacks(needle_pairs *pairs, const resting_needle *r, const shaft_piece *piece, mat3 *lacks, bool *any, trocar_error *why);

/* Computes the part of the compliance (m/N) between this needle's rows and another needle's that the mesh does not resolve: [u * ld + v]. Allocates. */
trocar_status resting_mutual(needle_pairs *pairs, const resting_needle *r, const resting_needle *other, double *compliance, int ld, trocar_error *why);

attachment resting_attachment(const resting_needle *r);

/* Return the current bounds of axial force i, which depend on how far the shaft has slid. */
double resting_upper(const insertion_model *model, const resting_needle *r, int i);
double resting_lower(const insertion_model *model, const resting_needle *r, int i);

/* Writes the needle's current state to an insertion state from which ticks can continue. */
void resting_show(const insertion_model *model, const resting_needle *r, needle_tangent *scratch, insertion_state *state);

#endif
