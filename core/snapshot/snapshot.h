/* What passes between the tick and the worker: requests one way, snapshots of the compliance between handles the other way. */
#ifndef TROCAR_SNAPSHOT_H
#define TROCAR_SNAPSHOT_H

#include "inverse/inverse_attached.h"
#include "linalg/rows.h"
#include "refinement/refinement.h"
#include "tissue/relaxation.h"

enum {
    MAX_WINDOW = 96,                            /* nominal nodes around the tip, behind it and ahead */
    MAX_HANDLES = MAX_CONTACTS + MAX_WINDOW,
    SNAPSHOT_LD = 3 * MAX_HANDLES,
};

/* The part of a needle's shaft that a point of contact stands for: straight, as the track is there. The same for a needle that is held and one
   that rests, for a contact and the tip. */
typedef struct {
    double from, to;         /* m of depth along the track; equal: there is no shaft, as where a needle was before */
    double depth;            /* m, of `place`, */
    vec3 place, direction;   /* m, nominal, and unit vector of the track */
    line_in_tet line;        /* on which what the mesh resolves is measured */
} shaft_piece;

/* A force on the tissue at a point of the nominal mesh. */
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 force;              /* N */
    shaft_piece shaft;       /* that exerts it */
} tissue_load;

/* Loads that relaxing tissue still remembers where nothing touches it any more: for each term of its creep, the force that the term
   follows. They decay with the terms' times. */
enum { MAX_LEFT = 64 };
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 at;                 /* m, nominal: the same point */
    vec3 load[MAX_RELAXATION]; /* N */
} left_load;

typedef struct {
    double time;             /* s, by the clock of the insertion: when they were these */
    int count;
    left_load loads[MAX_LEFT];
} left_loads;

enum { MAX_NEEDLES = 32, MAX_LOADS = MAX_CONTACTS + 1 + MAX_LEFT };

/* Of one needle. */
typedef struct {
    int count;
    tissue_load loads[MAX_LOADS];
} tissue_loads;

/* What else loads the tissue beside the needle that asks. */
typedef struct {
    int count;               /* other needles that are held, */
    const tissue_loads *of[MAX_NEEDLES];
    inverse *beneath;        /* attached inverse that holds the needles at rest, but not the probe: */
    const double *attached;  /* N, forces at all its rows; NULL: there are none */
    const nodal_forces *pressed; /* and the probe's, under which the tissue yields as `beneath` says; NULL: there are none */
} other_loads;

/* What the mesh resolves of the needle there: where the line comes in, half way, and where it goes out. */
typedef struct {
    line_in_tet line;
    double length;           /* m, of the line within the element */
    vec3 start;              /* m, where it comes in */
    resolved_field at[MAX_RESOLVED];
} line_piece;

enum { MAX_PIECES = 16 };

/* What the tick needs to know about the tissue next: a complete description, so that only the newest one counts. */
typedef struct {
    uint64_t serial;
    refinement wanted;
    int window_count;
    int window[MAX_WINDOW];  /* nominal nodes */
    int piece_count;
    line_in_tet pieces[MAX_PIECES]; /* of the way around the tip */
    int needed;              /* number at the front of the window that are indispensable; others may be left out if costly (inverse_holds) */
    vec3 tip, direction;     /* m, the needle's line (unit vector, or zero: unknown): remesher_look_ahead follows it */
    left_loads left;
} remesh_request;

/* Compliance between the contact in slot i and those in slots j >= i, in rows for the tick: [a][b][j] is component a of the displacement at i
   under a force along b at j. As a rule, from base to tip. Numbers of slots not in use mean nothing, but are finite. */
enum { CONTACT_COLUMNS = MAX_CONTACTS + ROW_ROOM }; /* and some that are read with them, in whole vectors */
typedef struct {
    double at[3][3][CONTACT_COLUMNS];
} contact_rows;

/* How far needles nearby displace the shaft beyond what the mesh resolves, along its track: summed up over depth, so that the mean over any part
   of it is a difference. */
enum { SHIFT_STEPS = 128 };
typedef struct {
    bool any;                /* it is not zero everywhere */
    double start, step;      /* m of depth */
    int count;               /* of steps; the last one goes on */
    vec3 sum[SHIFT_STEPS + 1]; /* m^2 */
} unresolved_shift;

/* Mean over this part of the track, m. RT */
vec3 unresolved_mean(const unresolved_shift *shift, double from, double to);

/* Where the track begins, m. RT */
static inline vec3 unresolved_at_entry(const unresolved_shift *shift) { return unresolved_mean(shift, shift->start, shift->start + shift->step); }

/* The answer: the inverse of the refined stiffness matrix between handles. The contact node in slot i is handle i, window entry k is
   handle MAX_CONTACTS + k; rows of handles not in use mean nothing. Immutable once handed over. */
typedef struct {
    uint64_t serial;         /* of the request that it answers; 0: none yet */
    uint64_t ids[MAX_CONTACTS]; /* of the contact node in each slot; 0: the slot is free */
    int window[MAX_WINDOW];  /* nominal node, or -1 where the place is free */
    resolved_field resolved[MAX_CONTACTS]; /* what the mesh resolves at each contact node */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, of the nominal mesh */
    int piece_count;
    line_piece pieces[MAX_PIECES];
    bool loaded;             /* u_free is not zero everywhere */
    vec3 u_free[MAX_HANDLES]; /* m, displacement of each handle that the needle itself does not cause */
    unresolved_shift unresolved; /* and what other needles add to it that the mesh does not resolve */
    bool left;               /* u_left is not zero everywhere */
    double left_time;        /* s, left_loads.time of the request */
    vec3 u_left[MAX_RELAXATION][MAX_HANDLES]; /* m, displacement at that time under each term's left loads */
    double compliance[SNAPSHOT_LD * SNAPSHOT_LD]; /* [(3 i + a) * SNAPSHOT_LD + 3 j + b], m/N */
} compliance_snapshot;

/* Handles of four nominal nodes in the snapshot; false if one is missing. RT */
bool snapshot_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]);

/* How many contact nodes, from the first in order to the first whose rows the snapshot does not hold. RT */
int snapshot_known_contacts(const compliance_snapshot *snapshot, const refinement *refined);

/* The line of the request that is in the same element and as close as this to the other; NULL: none. RT */
typedef struct {
    double aside, turn;      /* m, rad */
} line_tolerance;
const line_in_tet *request_line(const remesh_request *request, const line_in_tet *line, line_tolerance tolerance);

static const line_tolerance SAME_FIELD = {0.3e-3, 0.05}; /* m and rad: what the mesh resolves on one line holds for another that differs by less. Chosen */

/* The piece in element `tet`, or NULL. RT */
const line_piece *snapshot_piece(const compliance_snapshot *snapshot, int tet);

/* What the mesh resolves at the point of the piece that is closest to x. RT */
resolved_field piece_at(const line_piece *piece, vec3 x);

/* Compliance between two handles, m/N; the nominal mesh's where both are contacts, so that a node that is added changes what is computed, not
   what is felt. RT */
mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other);

#endif
