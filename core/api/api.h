/* What is behind the handles of trocar.h; for its own files only. */
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

/* One needle of a simulation. */
typedef struct {
    needle_link link;
    /* The ticking thread's: */
    insertion_state state;   /* while it is held; as it was, while it rests */
    uint64_t stamp;          /* another one when `state` changes */
    double base_compliance;  /* m/N, of the spring that holds the base */
    pose given;              /* where the last tick or reset would have the base */
    tissue_loads loads;      /* its own forces now */
    double since_loads;      /* s, since they were last handed over */
    /* The worker's: */
    remesher *remesher;      /* the nodes of this needle */
    bool loaded;             /* as in the last answer, */
    vec3 u_free[MAX_HANDLES]; /* m, likewise: found once for each request, */
    unresolved_shift unresolved;
    tissue_loads held;       /* its forces as far as they are known; of one that rests, only those where it is no longer */
    resting_needle *resting; /* NULL: it has never rested */
    bool attached;           /* it rests */
    uint64_t served_changes, served_shifts; /* of the resting needles, as in the last answer */
    double shown_force[MAX_UNKNOWNS]; /* N, as they were shown last */
} needle_track;

struct trocar_sim {
    trocar_model *model;
    int needle_count;
    needle_track *needles;
    sim_link link;
    /* The ticking thread's: */
    insertion_workspace *workspace;
    int64_t (*clock)(void);  /* ns; NULL: nothing is measured */
    seed_list seeds;
    vec3 *field_scratch;     /* of trocar_sim_displacements, NULL before the first */
    /* The worker's: */
    inverse *inverse;        /* with what rests attached to it, or the model's, where needles cannot rest */
    needle_pairs *pairs;     /* NULL: there is one needle only */
    resting_set resting;
    resting_scratch *resting_scratch; /* NULL before the first */
    uint64_t last_attached;  /* id */
    int next_served;         /* needle whose request it looks for first, */
    int next_shown;          /* and after which it looks for one to show */
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

/* For one more user, who gives it back with trocar_model_free. */
static inline trocar_model *model_share(trocar_model *model) {
    atomic_fetch_add_explicit(&model->users, 1, memory_order_relaxed);
    return model;
}

static inline bool has_needle(const trocar_model *model, int needle) { return needle >= 0 && needle < model->parts.config.needle_count; }

#endif
