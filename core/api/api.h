/* What is behind the handles of trocar.h; for its own files only. */
#ifndef TROCAR_API_H
#define TROCAR_API_H

#include "base/triple_buffer.h"
#include "scene/scene.h"
#include "insertion/simulation.h"
#include "remesh/refined_mesh.h"

struct trocar_scene {
    scene values;
    trocar_mesh mesh;        /* copy of a mesh that came as arrays; empty without one */
    char **names;            /* of its regions, then of its surfaces */
};

struct trocar_model {
    simulation parts;        /* without those of one run */
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
    tissue_loads others;     /* forces of the other needles */
} posted_request;

/* One needle of a simulation, and its way to the worker and back. */
typedef struct {
    insertion_state state;
    double base_compliance;  /* m/N, of the spring that holds the base */
    remesher *remesher;      /* the worker's: the nodes of this needle */
    triple_buffer requests;  /* posted_request: tick -> worker */
    triple_buffer snapshots; /* compliance_snapshot: worker -> tick */
    pose given;              /* where the last tick or reset would have the base */
    uint64_t posted;         /* serial of the last request handed over, */
    uint64_t answered;       /* and of the one that the last tick had the answer to */
    int64_t asked[REQUESTS_REMEMBERED]; /* ns, when the request of this serial (modulo) was handed over */
    tissue_loads others;     /* forces of the other needles now, */
    tissue_loads posted_others; /* and as they were when they were last handed over */
    bool loaded;             /* the worker's: as in the last snapshot, */
    vec3 u_free[MAX_HANDLES]; /* m, likewise: found once for each request */
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
};

/* A copy of what there is to see. */
struct trocar_picture {
    trocar_model *model;
    insertion_state states[MAX_NEEDLES]; /* as many as the model has needles */
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

static inline bool has_needle(const trocar_model *model, int needle) { return needle >= 0 && needle < model->parts.config.needle_count; }

/* BAD_INPUT, with a message unless `why` is NULL, for a needle that does not exist. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, report *why);

/* What trocar_sim_contacts and the like say of a state. RT */
int contacts_of(const trocar_model *model, const insertion_state *state, trocar_contact *contacts, int room);
int tracks_of(const insertion_state *state, trocar_track_point *points, int room);
int centreline_of(const trocar_model *model, const insertion_state *state, double *joints, int room);
trocar_pose pose_out(pose base);

/* Forces of all needles but the first, on the mesh without contact nodes; `states` has one pointer for each needle of the model. */
void loads_of_others(const trocar_model *model, const insertion_state *const states[], tissue_loads *others);
/* Displacements of the mesh's nodes and of the first needle's contact nodes. Allocates *scratch if it is NULL. NO_MEMORY. */
trocar_status field_of(trocar_model *model, const insertion_state *const states[], vec3 **scratch, vec3 *nominal, vec3 *added, report *why);

#endif
