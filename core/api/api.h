/* What is behind the handles of trocar.h; for its own files only. */
#ifndef TROCAR_API_H
#define TROCAR_API_H

#include <stdatomic.h>

#include "base/triple_buffer.h"
#include "scene/scene.h"
#include "insertion/simulation.h"
#include "probe/probe.h"
#include "remesh/refined_mesh.h"
#include "resting/resting_set.h"

struct trocar_scene {
    scene values;
    trocar_mesh mesh;        /* copy of a mesh that came as arrays; empty without one */
    char **names;            /* of its regions, then of its surfaces */
};

struct trocar_model {
    simulation parts;        /* without those of one run */
    atomic_int users;        /* the host, until it frees the model, and the simulations, pictures and models that are made from it */
    trocar_model *base;      /* whose mesh, stiffness and inverse it shares; NULL: its own */
    double rate_hz;
    pose start;              /* of the base; its position is NAN: none */
    double patient_to_mesh[16]; /* the first is NAN: none */
    bool mesh_only;          /* nothing but the mesh, regions and membranes */
};

enum { REQUESTS_REMEMBERED = 1024 };

/* What the tick hands to the worker. */
typedef struct {
    int64_t asked;           /* ns, by the simulation's clock */
    remesh_request request;
} posted_request;

/* What the ticking thread hands over of a needle that is left. */
typedef struct {
    insertion_state state;
    track_list others;       /* tracks of other needles that its tip may come to */
} left_needle;

/* What the worker shows of a needle that rests. */
typedef struct {
    uint64_t stamp;
    insertion_state state;
} shown_needle;

/* What the worker shows of the probe. */
typedef struct {
    uint64_t stamp;
    trocar_probe told;
    int count, nodes[MAX_PRESSED]; /* that it presses, */
    vec3 force[MAX_PRESSED];       /* N, on the tissue */
} shown_probe;

/* Who has a needle. The ticking thread: HELD, and TAKEN, after which it adopts what the worker shows. The worker: the others. */
typedef enum { PHASE_HELD, PHASE_LEAVING, PHASE_RESTING, PHASE_TAKING, PHASE_TAKEN, PHASES } needle_phase;

/* One needle of a simulation, and its way to the worker and back. */
typedef struct {
    atomic_uint phase;       /* needle_phase, and PHASES times how often the ticking thread has changed it: a needle that is reset and left
                                again while the worker lays it down is not the one that it lays down */
    insertion_state state;   /* while it is held; as it was, while it rests */
    uint64_t stamp;          /* another one when `state` changes */
    double base_compliance;  /* m/N, of the spring that holds the base */
    remesher *remesher;      /* the worker's: the nodes of this needle */
    triple_buffer requests;  /* posted_request: tick -> worker */
    triple_buffer snapshots; /* compliance_snapshot: worker -> tick */
    pose given;              /* where the last tick or reset would have the base */
    uint64_t posted;         /* serial of the last request handed over, */
    uint64_t answered;       /* and of the one that the last tick had the answer to */
    int64_t asked[REQUESTS_REMEMBERED]; /* ns, when the request of this serial (modulo) was handed over */
    tissue_loads loads;      /* its own forces now, */
    tissue_loads posted_loads; /* and as they were when they were last handed over; */
    double since_loads;      /* s, since then */
    atomic_llong since_release; /* ns that it has been ticked since another one was let go of */
    triple_buffer loads_out; /* tissue_loads: tick -> worker */
    triple_buffer left;      /* left_needle: tick -> worker, when it is left */
    triple_buffer shown;     /* shown_needle: worker -> tick */
    atomic_bool stale;       /* what the worker has told it no longer holds: it asks again */
    /* The worker's: */
    bool loaded;             /* as in the last snapshot, */
    vec3 u_free[MAX_HANDLES]; /* m, likewise: found once for each request, */
    unresolved_shift unresolved;
    tissue_loads held;       /* its forces as far as they are known; of one that rests, only those where it is no longer */
    resting_needle *resting; /* NULL: it has never rested */
    bool attached;           /* it rests */
    uint64_t served_changes, served_shifts; /* of the resting needles, as in the last snapshot */
    double shown_force[MAX_UNKNOWNS]; /* N, as they were shown last */
} needle_track;

struct trocar_sim {
    trocar_model *model;
    int needle_count;
    needle_track *needles;
    insertion_workspace *workspace; /* of the ticking thread */
    int64_t (*clock)(void);  /* ns; NULL: nothing is measured */
    int work_wake;           /* eventfd: a request waits */
    seed_list seeds;
    int next_served;         /* needle whose request the worker looks for first */
    vec3 *field_scratch;     /* of trocar_sim_displacements, NULL before the first */
    atomic_int resting_count; /* needles that rest; set by the worker */
    triple_buffer probe_poses; /* pose: of the probe, tick -> worker; */
    triple_buffer probe_shown; /* shown_probe: worker -> tick; without slots where the scene has no probe */
    atomic_bool probe_placed; /* a pose has been asked for */
    /* The worker's: */
    inverse *inverse;        /* with what rests attached to it, or the model's, where needles cannot rest */
    needle_pairs *pairs;     /* NULL: there is one needle only */
    resting_set resting;
    resting_scratch *resting_scratch; /* NULL before the first */
    uint64_t last_attached;  /* id */
    int next_shown;          /* needle after which it looks for one to show */
    probe *probe;            /* NULL: the scene has none */
    bool probe_posed;        /* a pose has come: */
    pose probe_pose;         /* the newest one */
    uint64_t probe_beneath;  /* resting.changes when it pressed last */
    double since_response;   /* s in lockstep since they responded to the loads */
    bool to_respond;         /* what rests and the probe have not responded to the newest loads and pose */
    int answers;             /* to requests since they did */
};

/* A copy of what there is to see. */
struct trocar_picture {
    trocar_model *model;
    insertion_state *states; /* as many as the model has needles, */
    uint64_t stamps[MAX_NEEDLES]; /* and which ones they are */
    shown_probe probe;
    int next_resting;        /* needle that is looked at first among those that rest */
    seed_list seeds;
    vec3 *scratch;           /* for displacements, NULL before the first */
    refined_mesh refined;    /* of the last trocar_picture_refined_mesh, */
    vec3 *force, *displacement; /* and of its nodes */
};

static inline void put(vec3 v, double out[3]) {
    out[0] = v.x;
    out[1] = v.y;
    out[2] = v.z;
}

/* What a scene may leave out: 0, and nothing is written, if it did. */
int start_out(pose start, trocar_pose *out);
int transform_out(const double matrix[16], double out[16]);

/* Only those in use: there is room for many. RT */
static inline void copy_loads(const tissue_loads *from, tissue_loads *to) {
    to->count = from->count;
    memcpy(to->loads, from->loads, (size_t)from->count * sizeof *from->loads);
}

/* For one more user, who gives it back with trocar_model_free. */
static inline trocar_model *model_share(trocar_model *model) {
    atomic_fetch_add_explicit(&model->users, 1, memory_order_relaxed);
    return model;
}

static inline bool has_needle(const trocar_model *model, int needle) { return needle >= 0 && needle < model->parts.config.needle_count; }

/* What trocar_sim_contacts and the like say of a state. RT */
int contacts_of(const trocar_model *model, const insertion_state *state, trocar_contact *contacts, int room);
int tracks_of(const insertion_state *state, trocar_track_point *points, int room);
int centreline_of(const trocar_model *model, const insertion_state *state, double *joints, int room);
trocar_pose pose_out(pose base);

/* Adds the forces of all needles but the first, and of the probe, on the mesh without contact nodes; `states` has one pointer for each needle
   of the model. */
void spread_others(const trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 *nominal);
/* Displacements of the mesh's nodes and of the first needle's contact nodes. Allocates *scratch if it is NULL. NO_MEMORY. */
trocar_status field_of(trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 **scratch, vec3 *nominal, vec3 *added, report *why);

/* ---- needles that rest (api_resting.c) ---------------------------------------------------------------------------------------- */

static inline needle_phase phase_of(const needle_track *needle) { return (needle_phase)(atomic_load_explicit(&needle->phase, memory_order_acquire) % PHASES); }

/* The ticking thread's. */
static inline void change_phase(needle_track *needle, needle_phase phase) {
    unsigned before = atomic_load_explicit(&needle->phase, memory_order_relaxed);
    atomic_store_explicit(&needle->phase, before - before % PHASES + PHASES + (unsigned)phase, memory_order_release);
}

/* The worker's: unless the ticking thread has changed it since it was `seen`. */
static inline void complete_phase(needle_track *needle, unsigned seen, needle_phase phase) {
    atomic_compare_exchange_strong(&needle->phase, &seen, seen - seen % PHASES + (unsigned)phase);
}

/* Of what is shown: another number each time, in this process. RT */
uint64_t next_stamp(void);

/* RT, but for one write() to an eventfd. */
void wake_worker(const trocar_sim *sim);

/* BAD_INPUT for a needle that does not exist. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, report *why);

/* The state to show: of a needle that rests, what the worker has made of it last. Ticking thread. RT */
const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp);

/* Hands a needle to the worker, which is to lay it down. Ticking thread. RT */
void post_left(trocar_sim *sim, int needle);

/* Goes on with a needle that the worker has handed over. Ticking thread. RT */
void adopt_needle(trocar_sim *sim, needle_track *needle);

typedef struct {
    bool any;                /* request was carried out, or failed */
    bool kept;               /* a needle that was to be left does not come to rest in the tissue: it is held as before */
} resting_change;

/* The worker's side: carries out pending requests to leave, take or remove needles. On an error the needle stays where it was. */
trocar_status change_resting(trocar_sim *sim, resting_change *change, report *why);

/* The worker's side: forces of held needles have changed. Not `all`: slip_some does the rest. */
trocar_status respond_to_loads(trocar_sim *sim, bool all, report *why);

/* The worker's side: lets what rests slip, all or one needle, and shows what has changed. True: there is more to do. */
bool slip_some(trocar_sim *sim, bool all);

/* ns over which the others come to feel that the hand has let go of a needle: about what fingers take to open (an assumption). In one tick it
   would be a knock of up to 0.5 N. */
static const int64_t RELEASE_TIME = 100000000;

/* After a restore: attaches what rests, and shows it. */
trocar_status make_room_to_rest(trocar_sim *sim, needle_track *needle, report *why);
trocar_status rest_again(trocar_sim *sim, report *why);

/* What deforms the tissue beside one needle, or beside all that rest, or beside the probe. Worker's side. */
enum { BESIDE_RESTING = -1, BESIDE_PROBE = -2 };
void list_others(const trocar_sim *sim, int needle, other_loads *others);

/* Puts the whole answer to a request into the worker's slot for this needle's snapshots. */
trocar_status answer_fully(trocar_sim *sim, int needle, const remesh_request *request, report *why);

/* Of all that is attached to the tissue, and of the forces that it exerts if no needle is held. Worker's side. */
static inline uint64_t attached_changes(const trocar_sim *sim) { return sim->resting.changes + (sim->probe ? sim->probe->changes : 0); }
static inline uint64_t attached_shifts(const trocar_sim *sim) { return sim->resting.shifts + (sim->probe ? sim->probe->shifts : 0); }

/* Other needles are to ask again. Worker's side. */
void mark_stale(trocar_sim *sim, const needle_track *except);

/* ---- the probe (api_probe.c) ------------------------------------------------------------------------------------------------------ */

/* BAD_INPUT for what is not finite or not of unit length. RT */
trocar_status check_pose(const trocar_pose *p, pose *out, report *why);

trocar_status create_probe(trocar_sim *sim, report *why);

/* What the worker has shown last; NULL: there is no probe. Ticking thread. RT */
const shown_probe *probe_shown(const trocar_sim *sim);

/* The worker's side. Takes the newest pose. True: there was one. */
bool take_probe_pose(trocar_sim *sim);

/* The worker's side: the probe presses where it is, after a move or when other loads have changed. */
trocar_status press_probe(trocar_sim *sim, report *why);

/* For save and restore. */
size_t saved_probe_size(const trocar_sim *sim);
void save_probe(const trocar_sim *sim, void *to);
trocar_status restore_probe(trocar_sim *sim, const void *from, report *why);

#endif
