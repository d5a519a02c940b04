/* The structs behind the handles of trocar.h; private to core/api. */
#ifndef TROCAR_API_H
#define TROCAR_API_H

#include <stdatomic.h>

#include "api/worker_protocol.h"
#include "insertion/simulation.h"
#include "probe/probe.h"
#include "refinement/refined_mesh.h"
#include "resting/resting_set.h"
#include "scene/scene.h"

struct trocar_scene {
    scene values;
    trocar_mesh mesh;        /* copy of a mesh that was given as arrays; empty without one */
    char **names;            /* names of its regions, then of its surfaces */
};

struct trocar_model {
    simulation parts;        /* constant data only */
    trocar_log log;          /* the host's */
    atomic_int users;        /* number of users: the host, until it frees the model, and the simulations, pictures and models created from it */
    trocar_model *base;      /* model whose mesh, stiffness and inverse it shares; NULL: its own */
    double rate_hz;
    pose start;              /* initial pose of the base; NAN position: none */
    double patient_to_mesh[16]; /* the first entry is NAN if there is none */
    bool mesh_only;          /* the model has only mesh, regions and membranes */
};

/* A simulation or a picture, as trocar_view_ functions read it. Part of that object. */
struct trocar_view {
    trocar_model *model;
    const trocar_sim *sim;   /* NULL: a picture */
    const trocar_picture *picture;
    vec3 **scratch;          /* of that object, for displacements; *scratch is NULL before the first */
};

/* Simulated time. Needles tick in rounds: a needle that ticks again begins the next one. */
typedef struct {
    double time;             /* s */
    uint32_t ticked;         /* bit i: needle i has ticked in this round */
} round_clock;

/* One needle of a simulation. */
typedef struct {
    needle_link link;
    /* Used by the ticking thread: */
    insertion_state state;   /* present state while held; while resting, the state in which it was left */
    uint64_t stamp;          /* changes whenever `state` changes */
    double base_compliance;  /* m/N, compliance of the spring that holds the base */
    pose given;              /* pose of the base in the last tick or reset */
    tissue_loads loads;      /* the needle's present forces on the tissue */
    double since_loads;      /* s, time since `loads` were last posted */
    /* Used by the worker: */
    remesher *remesher;      /* contact nodes of this needle */
    bool loaded;             /* u_free of the last answer is not zero everywhere */
    vec3 u_free[MAX_HANDLES]; /* m, as in the last answer: computed once per request */
    unresolved_shift unresolved;
    tissue_loads held;       /* the needle's last known forces; while resting, only its residual loads */
    resting_needle *resting; /* NULL: it has never rested */
    bool attached;           /* the needle is attached to the tissue */
    uint64_t served_changes, served_shifts; /* counts for the resting needles and the probe, as of the last answer */
    double shown_force[MAX_UNKNOWNS]; /* N, forces that were last shown */
} needle_track;

struct trocar_sim {
    trocar_model *model;
    trocar_view view;
    int needle_count;
    needle_track *needles;
    sim_link link;
    /* Used by the ticking thread: */
    insertion_workspace *workspace;
    int64_t (*clock)(void);  /* ns; NULL: stages are not timed */
    round_clock rounds;
    seed_list seeds;
    vec3 *field_scratch;     /* see trocar_view.scratch */
    /* Used by the worker: */
    inverse *inverse;        /* inverse with resting needles and probe attached; the model's if nothing can be attached */
    needle_pairs *pairs;     /* NULL: there is only one needle */
    resting_set resting;
    resting_scratch *resting_scratch; /* NULL until a needle is first left */
    uint64_t last_attached;  /* id of the needle attached last */
    int next_served;         /* needle whose request is checked next */
    int next_shown;          /* needle checked last for being shown */
    probe *probe;            /* NULL: the scene has no probe */
    bool probe_posed;        /* a pose has been received */
    pose probe_pose;         /* the newest pose */
    uint64_t probe_beneath;  /* resting.changes when the probe pressed last */
    double since_response;   /* s of lockstep time since the last response to the loads */
    bool to_respond;         /* resting needles and probe have not responded to the newest loads and pose yet */
    int answers;             /* requests answered since the last response */
};

/* A copy of the visible state of a simulation. */
struct trocar_picture {
    trocar_model *model;
    double time;             /* s, simulated */
    trocar_view view;
    insertion_state *states; /* one for each of the model's needles */
    uint64_t stamps[MAX_NEEDLES]; /* stamp of each copied state */
    pose bases[MAX_NEEDLES];
    shown_probe probe;
    int next_resting;        /* resting needle that is checked first */
    seed_list seeds;
    vec3 *scratch;           /* see trocar_view.scratch */
    refined_mesh refined;    /* result of the last trocar_picture_refined_mesh */
    vec3 *force, *displacement; /* forces and displacements at its nodes */
};

/* Adds a user, who must call trocar_model_free. */
static inline trocar_model *model_share(trocar_model *model) {
    atomic_fetch_add_explicit(&model->users, 1, memory_order_relaxed);
    return model;
}

static inline bool has_needle(const trocar_model *model, int needle) { return needle >= 0 && needle < model->parts.config.needle_count; }

#endif
