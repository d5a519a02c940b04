/* A needle that rests: nobody holds it, and tissue and guides keep it where it is. It responds to what else deforms the tissue as it does
   linearised about the equilibrium in which it was left. See docs/mechanics.md, "Resting needles". */
#ifndef TROCAR_RESTING_NEEDLE_H
#define TROCAR_RESTING_NEEDLE_H

#include "insertion/state/tick.h"
#include "inverse/inverse_attached.h"
#include "snapshot/needle_pairs.h"

enum { MAX_MOTIONS = 5 };    /* of its base: all but the turn about the needle's axis, which friction resists */

typedef struct { vec3 shift, turn; } base_motion; /* m, rad about the base, world frame */

/* Plain data. Forces are unknowns of the contact problem, in its order: on tissue and guides, in the needle's frame. */
typedef struct {
    uint64_t id;             /* a new one each time the needle is left */
    insertion_state anchor;  /* the equilibrium in which it was left */
    int point_count, unknown_count, axial_count;
    bool tip;                /* the last point is the tip */
    contact_point points[MAX_POINTS];
    attached_row rows[MAX_UNKNOWNS];
    tissue_loads places;                           /* where it loads the tissue: those of its points that are at no guide; forces are not used, */
    shaft_steps steps;                             /* and its track */
    double compliance[MAX_UNKNOWNS][MAX_UNKNOWNS]; /* m/N, lower triangle: of the needle with its base clamped, guides, and tissue around the shaft */
    int motion_count;
    double motions[MAX_MOTIONS][MAX_UNKNOWNS];     /* displacement of each row under each motion of the base, */
    base_motion twists[MAX_MOTIONS];                     /* which is this */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, which the forces along the needle can reach at the anchor */
    double anchor_force[MAX_UNKNOWNS];             /* N */
    double beside[MAX_UNKNOWNS];                   /* N, of loads on the tissue that are no force of the needle: what relaxing tissue remembers */
    double free_force[MAX_UNKNOWNS], free_motion[MAX_MOTIONS]; /* forces and motion if no needle were held, */
    double force[MAX_UNKNOWNS], motion[MAX_MOTIONS];           /* and as they are */
    double aside[MAX_UNKNOWNS];                    /* N, the part of them by what held needles displace it and the mesh does not resolve */
    double fading[MAX_UNKNOWNS];                   /* N: what its rows bore before the last release beyond what they bear after it (resting_set) */
    double slip[MAX_AXIAL], slid[MAX_AXIAL];       /* m, of the shaft forward past the tissue since the anchor; and the total distance slid */
} resting_needle;

/* What linearising takes beside a tick's input: of the worker. */
typedef struct {
    insertion_workspace workspace;
    insertion_state state;
    double matrix[MAX_UNKNOWNS][MAX_UNKNOWNS];
} resting_scratch;

/* Linearises about `state`, an equilibrium, whose rows tick->snapshot holds as `inv` gives them now. BAD_INPUT
   if the needle touches no tissue. Allocates. */
trocar_status resting_linearise(const tick_input *tick, const insertion_state *state, inverse *inv, resting_scratch *scratch, resting_needle *r, report *why);

/* Puts what its rows bore in `held`, the state in which the hand let go of it, into r->fading. After resting_linearise. */
void resting_bore(const insertion_model *model, const insertion_state *held, resting_needle *r);

/* How the base has to move for its wrench to vanish, if nothing slides; `size` times that
   along the needle, within limits. After resting_linearise. NUMERIC:
   needle and tissue are not stable. */
trocar_status resting_release_step(const resting_needle *r, double size, resting_scratch *scratch, base_motion *step, report *why);
pose pose_moved(pose base, base_motion step);

/* The row's place, counted as in `places`, or -1: it is at a guide. */
int resting_place(const resting_needle *r, int u);

/* How far a place moves with the steps of its track. */
vec3 resting_moved(const resting_needle *r, int place, int from, int to, const vec3 *moved);

/* Compliance between the needle's rows and another one's that the mesh does not resolve, m/N: [u * ld + v]. Allocates. */
trocar_status resting_mutual(needle_pairs *pairs, const resting_needle *r, const resting_needle *other, double *compliance, int ld, report *why);

attachment resting_attachment(const resting_needle *r);

/* The bound of axial force number i now, with what the shaft has slid. */
double resting_upper(const insertion_model *model, const resting_needle *r, int i);
double resting_lower(const insertion_model *model, const resting_needle *r, int i);

/* The state of the needle now, from which ticks can go on. */
void resting_show(const insertion_model *model, const resting_needle *r, needle_tangent *scratch, insertion_state *state);

#endif
