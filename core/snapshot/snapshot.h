/* The messages between tick and worker: the tick sends requests; the worker sends snapshots of the compliance between handles. */
#ifndef TROCAR_SNAPSHOT_H
#define TROCAR_SNAPSHOT_H

#include "inverse/inverse_attached.h"
#include "linalg/rows.h"
#include "refinement/refinement.h"
#include "tissue/relaxation.h"

enum {
    MAX_WINDOW = 96,                            /* nominal nodes around, behind and ahead of the tip */
    MAX_HANDLES = MAX_CONTACTS + MAX_WINDOW,
    SNAPSHOT_LD = 3 * MAX_HANDLES,
};

/* The piece of a needle's shaft that a contact point represents: a straight line along the track at that point. Used for held and resting needles, for
   contacts and the tip. */
typedef struct {
    double from, to;         /* m, depths along the track; equal if the force acts without a shaft */
    double depth;            /* m, depth at `place` */
    vec3 place, direction;   /* place, m: nominal point on the track; direction: unit vector along the track */
    line_in_tet line;        /* line on which the mesh's resolution is measured */
} shaft_piece;

/* A force on the tissue at a point of the nominal mesh. */
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 force;              /* N */
    bool residual;           /* a residual load: the needle is no longer at `shaft` */
    shaft_piece shaft;       /* the piece of shaft that exerts the force, or exerted it */
} tissue_load;

/* A residual load: a load that relaxing tissue remembers at a place that nothing touches any more. For each term of the creep series, it stores the
   filtered force, which decays with the term's time constant. */
enum { MAX_RESIDUAL_LOADS = 64 };
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 at;                 /* m, nominal position of the load */
    double modulus;          /* Pa, Young's modulus of the element on which `load` is based */
    shaft_piece shaft;       /* the piece of shaft that exerted the load */
    vec3 load[MAX_RELAXATION]; /* N */
} residual_load;

typedef struct {
    double time;             /* s, time on the insertion's clock to which these values refer */
    int count;
    residual_load loads[MAX_RESIDUAL_LOADS];
} residual_loads;

enum { MAX_NEEDLES = 32, MAX_LOADS = MAX_CONTACTS + 1 + MAX_RESIDUAL_LOADS };

/* Loads of one needle on the tissue. */
typedef struct {
    int count;
    tissue_load loads[MAX_LOADS];
} tissue_loads;

/* The loads on the tissue of everything except the requesting needle. */
typedef struct {
    int count;               /* number of other held needles */
    const tissue_loads *of[MAX_NEEDLES];
    inverse *beneath;        /* inverse to which the resting needles are attached, but not the probe */
    const double *attached;  /* N, forces at all rows of that inverse; NULL if there are none */
    const nodal_forces *pressed; /* forces of the probe, to which the tissue responds as in `beneath`; NULL if there are none */
} other_loads;

/* The mesh's resolution along a line through an element: at its entry, middle and exit point. */
typedef struct {
    line_in_tet line;
    double length;           /* m, length of the line within the element */
    vec3 start;              /* m, point at which the line enters the element */
    resolved_field at[MAX_RESOLVED];
} line_piece;

enum { MAX_PIECES = 16 };

/* The tick's request for data about the tissue. Each request is complete in itself, so that only the newest one matters. */
typedef struct {
    uint64_t insertion;      /* number of resets before this request */
    uint64_t serial;
    refinement wanted;
    int window_count;
    int window[MAX_WINDOW];  /* indices of nominal nodes */
    int piece_count;
    line_in_tet pieces[MAX_PIECES]; /* lines along the path near the tip */
    int needed;              /* number of window nodes, at the front of the list, that are indispensable; the others may be omitted if costly (inverse_holds) */
    vec3 tip, direction;     /* the needle's line, along which remesher_look_ahead prefetches: a point (m) and a unit vector (zero if unknown) */
    residual_loads residual_loads;
} remesh_request;

/* Compliance between the contact in slot i and those in slots j >= i, stored in rows for the tick: [a][b][j] is component a of the displacement at i under
   a force along b at j. Slots are usually in order from base to tip. Entries of unused slots are meaningless but finite. */
enum { CONTACT_COLUMNS = MAX_CONTACTS + ROW_ROOM }; /* number of columns, padded because whole vectors are read */
typedef struct {
    double at[3][3][CONTACT_COLUMNS];
} contact_rows;

/* The displacement that nearby needles cause along the shaft's track, as far as the mesh does not resolve it. It is stored as a running sum over depth, so that
   the mean over any interval follows from the difference between two sums. */
enum { SHIFT_STEPS = 128 };
typedef struct {
    bool any;                /* true if the displacement is not zero everywhere */
    double start, step;      /* m, depth at which the first step starts, and length of a step */
    int count;               /* number of steps; the last value also applies beyond the last step */
    vec3 sum[SHIFT_STEPS + 1]; /* m^2 */
} unresolved_shift;

/* Mean of the displacement (m) over an interval of the track. RT */
vec3 unresolved_mean(const unresolved_shift *shift, double from, double to);

/* The worker's answer: the inverse of the refined stiffness matrix between handles. The contact node in slot i is handle i; window entry k is handle
   MAX_CONTACTS + k. Rows of unused handles are meaningless. Immutable once published. */
typedef struct {
    uint64_t insertion;      /* `insertion` of the answered request */
    uint64_t serial;         /* serial of the answered request; 0 if there has been no answer yet */
    uint64_t ids[MAX_CONTACTS]; /* id of the contact node in each slot; 0 if the slot is free */
    int window[MAX_WINDOW];  /* nominal node at each place of the window; -1 if the place is free */
    resolved_field resolved[MAX_CONTACTS]; /* the mesh's resolution at each contact node */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, compliance of the nominal mesh between contacts */
    int piece_count;
    line_piece pieces[MAX_PIECES];
    bool loaded;             /* true if u_free is not zero everywhere */
    vec3 u_free[MAX_HANDLES]; /* m, displacement of each handle due to all causes except the needle itself */
    unresolved_shift unresolved; /* displacement caused by other needles that the mesh does not resolve */
    bool has_residuals;      /* true if u_residual is not zero everywhere */
    double residual_time;    /* s, residual_loads.time of the request */
    vec3 u_residual[MAX_RELAXATION][MAX_HANDLES]; /* m, displacement at residual_time under the residual loads of each term */
    unresolved_shift unresolved_residual[MAX_RELAXATION]; /* displacement of the shaft under these loads that the mesh does not resolve; valid if
                                                             has_residuals */
    double compliance[SNAPSHOT_LD * SNAPSHOT_LD]; /* m/N, between handles i and j: [(3 i + a) * SNAPSHOT_LD + 3 j + b] */
} compliance_snapshot;

/* Empties the snapshot, as if there had been no answer yet. RT */
void snapshot_empty(compliance_snapshot *snapshot);

/* Finds the handles of four nominal nodes in the snapshot; returns false if any is missing. RT */
bool snapshot_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]);

/* Number of contact nodes, in order, before the first one whose rows the snapshot does not contain. RT */
int snapshot_known_contacts(const compliance_snapshot *snapshot, const refinement *refined);

/* Returns a line of the request that is in the same element as `line` and differs from it by at most this tolerance; NULL if there is none. RT */
typedef struct {
    double aside, turn;      /* m, rad */
} line_tolerance;
const line_in_tet *request_line(const remesh_request *request, const line_in_tet *line, line_tolerance tolerance);

static const line_tolerance SAME_FIELD = {0.3e-3, 0.05}; /* m and rad: differences within which two lines are considered to have the same resolution.
                                                            Chosen by judgement */

/* Returns the piece in element `tet`, or NULL. RT */
const line_piece *snapshot_piece(const compliance_snapshot *snapshot, int tet);

/* The mesh's resolution at the point of the piece that is closest to x. RT */
resolved_field piece_at(const line_piece *piece, vec3 x);

/* Compliance (m/N) between two handles. Between two contacts, it is that of the nominal mesh, so that adding a node does not change the force that is felt.
   RT */
mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other);

#endif
