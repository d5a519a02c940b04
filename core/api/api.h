/* The structs behind the handles of trocar.h; private to core/api. */
#ifndef TROCAR_API_H
#define TROCAR_API_H

#include <stdatomic.h>

#include "api/worker_protocol.h"
#include "changes/elasticity.h"
#include "model/model_parts.h"
#include "probe/probe.h"
#include "refinement/refined_mesh.h"
#include "resting/resting_set.h"
#include "scene/scene.h"

struct trocar_scene {
    scene values;
    trocar_mesh mesh;        /* copy of the mesh if it was given as arrays; otherwise empty */
    char **names;            /* names of the mesh's regions, followed by those of its surfaces */
};

struct trocar_model {
    model_parts parts;       /* immutable data, shared by all simulations of the model */
    trocar_log log;          /* the host's log */
    atomic_int users;        /* reference count: one for the host, until it frees the model, and one for each simulation, picture or model made from it */
    trocar_model *base;      /* model whose mesh, and possibly stiffness and inverse, this one shares; NULL if it has its own */
    trocar_model *next_retired; /* see model_release */
    uint64_t mesh_checksum;  /* checksum of the mesh, which all models derived from this one share */
    uint64_t checksum;       /* checksum of everything that affects results; saved in each state, so that it is restored only to an equal model */
    double rate_hz;
    pose start;              /* initial pose of the needle's base; its position is NAN if the scene gives none */
    double patient_to_mesh[16]; /* the first entry is NAN if the scene gives no transform */
    bool mesh_only;          /* true if the model has only mesh, regions and membranes */
};

/* The object behind the trocar_view_* functions: a member of the simulation or picture that it shows. */
struct trocar_view {
    trocar_model *model;
    const trocar_sim *sim;   /* the simulation shown; NULL if this is a picture's view */
    const trocar_picture *picture;
    vec3 **scratch;          /* scratch memory for displacements, owned by the simulation or picture; *scratch is NULL until first used */
};

/* Simulated time. Needles tick in rounds: when a needle that has already ticked in the current round ticks again, a new round begins. */
typedef struct {
    double time;             /* s */
    uint32_t ticked;         /* bit i: needle i has ticked in this round */
} round_clock;

/* One needle of a simulation. */
typedef struct {
    needle_link link;
    /* Used by the ticking thread: */
    insertion_state state;   /* the needle's current state while it is held; its state when it was left while it rests */
    uint64_t stamp;          /* changes whenever `state` changes */
    uint64_t softened;       /* value of elasticity.moves for which the shear and the memory in `state` are valid */
    double base_compliance;  /* m/N, compliance of the spring between the commanded pose and the base */
    pose given;              /* base pose commanded in the last tick or reset */
    tissue_loads loads;      /* the needle's current forces on the tissue */
    double since_loads;      /* s, simulated time since `loads` were last posted to the worker */
    /* Used by the worker: */
    remesher *remesher;      /* contact nodes of this needle */
    bool loaded;             /* whether `u_free` in the last answer is nonzero anywhere */
    vec3 u_free[MAX_HANDLES]; /* m, free displacements in the last answer; computed once per request */
    unresolved_shift unresolved, unresolved_residual[MAX_RELAXATION]; /* copies of those in the last answer's snapshot */
    tissue_loads held;       /* the needle's forces on the tissue, as the worker last knew them; while the needle rests, only its residual loads */
    resting_needle *resting; /* NULL if the needle has never rested */
    bool attached;           /* true if the needle is attached to the tissue, as a resting needle */
    uint64_t served_changes, served_shifts; /* values of attached_changes() and attached_shifts() at the last answer */
    double shown_force[MAX_UNKNOWNS]; /* N, the resting needle's forces when the worker last published it */
} sim_needle;

struct trocar_sim {
    trocar_model *model;
    trocar_view view;
    int needle_count;
    sim_needle *needles;
    sim_link link;
    /* Used by the ticking thread: */
    insertion_workspace *workspace; /* scratch memory for ticks; in lockstep, several simulations may share it */
    bool borrows_workspace;    /* true if the workspace belongs to the caller of sim_create, so it must not be freed here */
    int64_t (*clock)(void);  /* returns the time in ns; NULL if nothing is timed */
    round_clock rounds;
    seed_list seeds;
    sim_changing *changing;  /* values that change during the run. In a batch, NULL until the first change; until then, the model's values apply */
    vec3 *field_scratch;     /* see trocar_view.scratch */
    inverse *shown;          /* inverse with the current moduli, for views; updated whenever displacements are computed */
    elasticity elasticity;   /* holds a reference to each of its models. Used by both threads: see elasticity.h */
    /* Used by the worker: */
    inverse *mixed;          /* inverse of the tissue alone, with the current moduli */
    inverse *inverse;        /* the same with resting needles and the probe attached */
    needle_pairs *pairs;     /* couplings between needles; NULL if there is only one needle and the tissue does not relax */
    resting_set resting;
    resting_scratch *resting_scratch; /* NULL until a needle is left in the tissue for the first time */
    uint64_t last_attached;  /* id of the most recently attached needle */
    int next_served;         /* index of the needle whose request is checked next */
    int next_shown;          /* index of the needle last checked for changes to publish */
    probe *probe;            /* NULL if the scene has no probe */
    bool probe_posed;        /* true if a pose has been received */
    pose probe_pose;         /* the newest pose of the probe */
    int64_t probe_time;      /* ns, simulated time at which the probe was last pressed on the tissue */
    uint64_t probe_beneath;  /* value of resting.changes when the probe was last pressed on the tissue; if it differs, the inverse beneath has changed */
    double since_response;   /* s, simulated time since resting needles and the probe last responded to the loads; lockstep only */
    bool to_respond;         /* true if resting needles and the probe have yet to respond to the newest loads and pose */
    int answers;             /* number of requests answered since the last response */
};

/* A snapshot of a simulation's visible state. */
struct trocar_picture {
    trocar_model *model;
    double time;             /* s, simulated time */
    trocar_view view;
    insertion_state *states; /* one per needle of the model */
    uint64_t stamps[MAX_NEEDLES]; /* for each needle, the stamp of the state that was copied */
    pose bases[MAX_NEEDLES];
    shown_probe probe;
    int next_resting;        /* index of the needle that the next copy checks first */
    seed_list seeds;
    trocar_model *from, *to; /* models between which the moduli are interpolated; the picture holds a reference to each */
    double weight;           /* weight of `to` in the interpolation, from 0 to 1 */
    inverse *mixed;          /* inverse of the tissue with the interpolated moduli */
    vec3 *scratch;           /* see trocar_view.scratch */
    refined_mesh refined;    /* result of the last call to trocar_picture_refined_mesh */
    vec3 *force, *displacement; /* forces and displacements at the nodes of `refined` */
};

/* Adds a reference to the model; release it with trocar_model_free or model_release. */
static inline trocar_model *model_share(trocar_model *model) {
    atomic_fetch_add_explicit(&model->users, 1, memory_order_relaxed);
    return model;
}

static inline moduli moduli_of(trocar_model *model) { return (moduli){model, &model->parts}; }

/* Builds a model like `base`, but with the moduli in `config`. Errors as in trocar_change_prepare. */
trocar_status model_stiffen(trocar_model *base, const simulation_config *config, const trocar_watch *watch, trocar_model **created, trocar_error *why);

/* model_release drops a reference but never frees memory, so a real-time thread can call it. Models without references are freed by model_free_retired, which
   a thread that is not real-time must call from time to time. model_release: RT */
void model_release(trocar_model *model);
void model_free_retired(void);

/* Creates a simulation. If `workspace` is NULL, the simulation allocates its own. Otherwise, it borrows this one, until given another, and can only run in
   lockstep: it has no work descriptor, and unused buffers take up no memory. NO_MEMORY, SYSTEM. Allocates. */
trocar_status sim_create(trocar_model *model, insertion_workspace *workspace, trocar_sim **sim, trocar_error *why);

/* Saves the state to newly allocated memory, which the caller must free. NO_MEMORY. */
trocar_status sim_save_new(const trocar_sim *sim, void **state, size_t *bytes, trocar_error *why);

/* Return the model with the parameter values currently used by the ticking thread and by the worker, respectively. RT */
static inline const insertion_model *ticking_model(const trocar_sim *sim) {
    return sim->changing ? &sim->changing->ticking.model : &sim->model->parts.insertion;
}
static inline const insertion_model *worker_model(const trocar_sim *sim) {
    return sim->changing ? &sim->changing->worker.model : &sim->model->parts.insertion;
}

static inline bool has_needle(const trocar_model *model, int needle) { return needle >= 0 && needle < model->parts.config.needle_count; }

#endif
