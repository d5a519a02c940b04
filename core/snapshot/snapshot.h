/* Messages between tick and worker. The tick sends requests; the worker answers with snapshots of the compliance between handles. */
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

/* The piece of shaft that a contact point stands for: a straight line along the track. Used for contacts and for the tip, of both held and resting needles. */
typedef struct {
    double from, to;         /* m, depths along the track; equal if the force does not act through a shaft */
    double depth;            /* m, depth at `place` */
    vec3 place, direction;   /* place: nominal point on the track, m; direction: unit vector along the track */
    line_in_tet line;        /* the line on which the mesh's resolution is measured */
} shaft_piece;

/* A force on the tissue at a point of the nominal mesh. */
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 force;              /* N */
    bool residual;           /* this is a residual load: the needle is no longer at `shaft` */
    shaft_piece shaft;       /* the piece of shaft that exerts or exerted the force */
} tissue_load;

/* A residual load: what relaxing tissue remembers of a load where nothing touches it any more. For each term of the creep series, this is the filtered force,
   which decays with the term's time constant. */
enum { MAX_RESIDUAL_LOADS = 64 };
typedef struct {
    int tet;
    double weights[4];       /* barycentric */
    vec3 at;                 /* m, nominal position of the load */
    double modulus;          /* Pa, Young's modulus of the element when `load` was computed */
    shaft_piece shaft;       /* the piece of shaft that exerted the load */
    vec3 load[MAX_RELAXATION]; /* N */
} residual_load;

typedef struct {
    double time;             /* s, when these values were valid, on the insertion's clock */
    int count;
    residual_load loads[MAX_RESIDUAL_LOADS];
} residual_loads;

enum { MAX_NEEDLES = 32, MAX_LOADS = MAX_CONTACTS + 1 + MAX_RESIDUAL_LOADS };

/* The loads that one needle exerts on the tissue. */
typedef struct {
    int count;
    tissue_load loads[MAX_LOADS];
} tissue_loads;

/* The loads that everything but the requesting needle exerts on the tissue. */
typedef struct {
    int count;               /* number of other held needles */
    const tissue_loads *of[MAX_NEEDLES];
    inverse *beneath;        /* the inverse with the resting needles attached, but not the probe */
    const double *attached;  /* N, the forces at all of that inverse's rows; NULL if none */
    const nodal_forces *pressed; /* the probe's forces, to which the tissue responds as in `beneath`; NULL if none */
} other_loads;

/* The mesh's resolution along a line through an element, at three points: entry, middle and exit. */
typedef struct {
    line_in_tet line;
    double length;           /* m, length inside the element */
    vec3 start;              /* m, where the line enters the element */
    resolved_field at[MAX_RESOLVED];
} line_piece;

enum { MAX_PIECES = 16 };

/* What the tick asks to know about the tissue. Every request is self-contained, so only the newest one matters. */
typedef struct {
    uint64_t insertion;      /* how many resets preceded this request */
    uint64_t serial;
    refinement wanted;
    int window_count;
    int window[MAX_WINDOW];  /* indices of nominal nodes */
    int piece_count;
    line_in_tet pieces[MAX_PIECES]; /* lines along the path near the tip */
    int needed;              /* the first `needed` window nodes are indispensable; the others may be omitted if they are costly (inverse_holds) */
    vec3 tip, direction;     /* the needle's line, for prefetching by remesher_look_ahead: a point (m), and a unit vector or zero if unknown */
    residual_loads residual_loads;
} remesh_request;

/* Compliance between the contact in slot i and those in slots j >= i, arranged in rows for the tick: [a][b][j] is the displacement at i along a per unit force
   at j along b. Slots usually follow the order from base to tip. In unused slots, entries are finite but meaningless. */
enum { CONTACT_COLUMNS = MAX_CONTACTS + ROW_ROOM }; /* padded, because whole SIMD vectors are read */
typedef struct {
    double at[3][3][CONTACT_COLUMNS];
} contact_rows;

/* The unresolved displacement due to nearby needles along the shaft's track, as a running sum over depth. The difference of two sums gives the mean over any
   interval.
   */
enum { SHIFT_STEPS = 128 };
typedef struct {
    bool any;                /* the displacement is not zero everywhere */
    double start, step;      /* m, depth at which the first step starts; length of a step */
    int count;               /* number of steps; beyond the last one, its value still applies */
    vec3 sum[SHIFT_STEPS + 1]; /* m^2 */
} unresolved_shift;

/* Returns the mean displacement (m) over an interval of the track. RT */
vec3 unresolved_mean(const unresolved_shift *shift, double from, double to);

/* The worker's answer: the inverse of the refined stiffness matrix between handles. Handle i is the contact node in slot i, and handle MAX_CONTACTS + k is
   window entry k. The rows of unused handles are meaningless. A published snapshot never changes. */
typedef struct {
    uint64_t insertion;      /* `insertion` of the answered request */
    uint64_t serial;         /* of the request that this answers; 0 if nothing has been answered yet */
    uint64_t ids[MAX_CONTACTS]; /* id of the contact node in each slot; 0 if none */
    int window[MAX_WINDOW];  /* nominal node in each place of the window; -1 if none */
    resolved_field resolved[MAX_CONTACTS]; /* the mesh's resolution at each contact node */
    contact_rows between_contacts[MAX_CONTACTS]; /* m/N, the nominal mesh's compliance between contacts */
    int piece_count;
    line_piece pieces[MAX_PIECES];
    bool loaded;             /* u_free is not zero everywhere */
    vec3 u_free[MAX_HANDLES]; /* m, displacement of each handle due to everything but the needle itself */
    unresolved_shift unresolved; /* unresolved displacement due to other needles */
    bool has_residuals;      /* u_residual is not zero everywhere */
    double residual_time;    /* s, residual_loads.time of the request */
    vec3 u_residual[MAX_RELAXATION][MAX_HANDLES]; /* m, displacements under each term's residual loads at time residual_time */
    unresolved_shift unresolved_residual[MAX_RELAXATION]; /* unresolved displacement of the shaft under these loads; valid if has_residuals */
    double compliance[SNAPSHOT_LD * SNAPSHOT_LD]; /* m/N, between handles i and j: [(3 i + a) * SNAPSHOT_LD + 3 j + b] */
} compliance_snapshot;

/* Empties the snapshot, as if nothing had been answered yet. RT */
void snapshot_empty(compliance_snapshot *snapshot);

/* Finds the handles of an element's four nominal corners. Returns false if the snapshot lacks any of them. RT */
bool snapshot_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]);

/* Counts the contact nodes, in order, up to the first whose rows the snapshot lacks. RT */
int snapshot_known_contacts(const compliance_snapshot *snapshot, const refinement *refined);

/* Returns a line of the request that is in the same element as `line` and within `tolerance` of it, or NULL. RT */
typedef struct {
    double aside, turn;      /* m, rad */
} line_tolerance;
const line_in_tet *request_line(const remesh_request *request, const line_in_tet *line, line_tolerance tolerance);

static const line_tolerance SAME_FIELD = {0.3e-3, 0.05}; /* m and rad: lines that differ by no more than this are taken to have the same resolution. Chosen by
                                                            judgement */

/* Returns the piece in element `tet`, or NULL. RT */
const line_piece *snapshot_piece(const compliance_snapshot *snapshot, int tet);

/* Returns the mesh's resolution at the point of the piece closest to x. RT */
resolved_field piece_at(const line_piece *piece, vec3 x);

/* Returns the compliance (m/N) between two handles. Between two contacts, this is the nominal mesh's compliance, so that adding a node does not change the
   force that is felt. RT */
mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other);

#endif
