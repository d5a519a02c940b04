/* A resting needle, which nobody holds: tissue and guides keep it in place. It responds linearly to other loads on the tissue, about the equilibrium it was
   left in; stiffening tissue is linearised again, about the present forces, when the moduli change. See docs/mechanics.md, "Resting needles". */
#ifndef TROCAR_RESTING_NEEDLE_H
#define TROCAR_RESTING_NEEDLE_H

#include "insertion/state/tick_data.h"
#include "inverse/inverse_attached.h"
#include "snapshot/needle_pairs.h"

enum { MAX_MOTIONS = 5 };    /* motions of the base: all but rotation about the needle's axis, which friction prevents */

typedef struct { vec3 shift, turn; } base_motion; /* in the world frame. shift: translation, m; turn: rotation about the base, rad */

/* Plain data. Forces on tissue and guides have the order of the contact problem's unknowns and are expressed in the needle's frame. */
typedef struct {
    uint64_t id;             /* a new one each time the needle is left */
    insertion_state anchor;  /* the equilibrium in which the needle was left */
    int point_count, unknown_count, axial_count;
    bool tip;                /* the last point is the tip */
    bool loaded;             /* `compliance` includes how the needle's forces change its own stiffness */
    bool alone;              /* `compliance` was computed with no needle attached, as after a change in moduli (resting_soften) */
    contact_point points[MAX_POINTS];
    attached_row rows[MAX_UNKNOWNS];
    tissue_loads places;                           /* where its loads act on the tissue: at all points except those at guides. The forces in it are not used */
    shaft_steps steps;                             /* the needle's track, in short steps */
    double compliance[MAX_UNKNOWNS][MAX_UNKNOWNS]; /* m/N, lower triangle: compliance of the needle clamped at its base, of the guides, and of the tissue around
                                                      the shaft */
    double offset[MAX_UNKNOWNS];                   /* m, what must be added to `compliance` times the forces: the tangents of stiffening tissue do not pass through
                                                      the origin */
    int motion_count;
    double motions[MAX_MOTIONS][MAX_UNKNOWNS];     /* how far each row moves under each motion of the base */
    base_motion twists[MAX_MOTIONS];                     /* the motion of the base that belongs to each row of `motions` */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, bounds on the axial forces at the anchor */
    double anchor_force[MAX_UNKNOWNS];             /* N, forces at the anchor */
    double beside[MAX_UNKNOWNS];                   /* N, loads on the tissue from the tissue's memory rather than from the needle */
    double free_force[MAX_UNKNOWNS], free_motion[MAX_MOTIONS]; /* forces and motions when no needle is held */
    double force[MAX_UNKNOWNS], motion[MAX_MOTIONS];           /* current forces and motion */
    double aside[MAX_UNKNOWNS];                    /* N, changes in the forces because held needles displace the tissue in a way that the mesh does not resolve
                                                      */
    double fading[MAX_UNKNOWNS];                   /* N, forces of the rows before the last release minus those after it (see resting_set) */
    double slip[MAX_AXIAL], slid[MAX_AXIAL];       /* m, slip of the shaft since the anchor (positive if forward relative to the tissue), and total distance
                                                      slid */
} resting_needle;

/* Scratch memory in which the worker linearises a needle. */
typedef struct {
    insertion_workspace workspace;
    insertion_state state;
    double matrix[MAX_UNKNOWNS][MAX_UNKNOWNS];
} resting_scratch;

/* Linearises about `state`, which must be an equilibrium. tick->snapshot must hold the needle's rows of `inv` as it is now. BAD_INPUT if the needle touches no
   tissue. Allocates. */
trocar_status resting_linearise(const tick_input *tick, const insertion_state *state, inverse *inv, resting_scratch *scratch, resting_needle *r,
                                trocar_error *why);

/* Recomputes `compliance` and `offset` after a change in moduli. tick->snapshot must hold the needle's rows of `inv`, and nothing may be attached to
   `inv`. */
trocar_status resting_soften(const tick_input *tick, inverse *inv, resting_scratch *scratch, resting_needle *r, trocar_error *why);

/* Sets r->fading to the forces of the rows in `held`, the state at the moment of release. Call after resting_linearise. */
void resting_bore(const insertion_model *model, const insertion_state *held, resting_needle *r);

/* Computes the motion of the base at which the wrench on the base would vanish if nothing slid. Multiplies the component along the needle by `size` and limits
   all components. Call after resting_linearise. NUMERIC if needle and tissue are unstable. */
trocar_status resting_release_step(const resting_needle *r, double size, resting_scratch *scratch, base_motion *step, trocar_error *why);
pose pose_moved(pose base, base_motion step);

/* Returns the row's index in `places`, or -1 if the row is at a guide. */
int resting_place(const resting_needle *r, int u);

/* Computes how far each place is displaced per unit force on a piece of another needle's shaft, counting only what the mesh does not resolve:
   lacks[places.count], m/N. If all of it is zero, sets *any to false and leaves `lacks` unset. */
trocar_status resting_lacks(needle_pairs *pairs, const resting_needle *r, const shaft_piece *piece, mat3 *lacks, bool *any, trocar_error *why);

/* Computes the compliance (m/N) between this needle's rows and another's, as [u * ld + v]. Only the part that the mesh does not resolve. Allocates. */
trocar_status resting_mutual(needle_pairs *pairs, const resting_needle *r, const resting_needle *other, double *compliance, int ld, trocar_error *why);

attachment resting_attachment(const resting_needle *r);

/* Return the current bounds on axial force i. They depend on how far the shaft has slid. */
double resting_upper(const insertion_model *model, const resting_needle *r, int i);
double resting_lower(const insertion_model *model, const resting_needle *r, int i);

/* Converts the needle's current state to an insertion state, from which ticks can continue. */
void resting_show(const insertion_model *model, const resting_needle *r, needle_tangent *scratch, insertion_state *state);

#endif
