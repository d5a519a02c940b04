/* trocar: a flexible needle in soft tissue, for haptic servers, planners and batches.

   A scene says what to simulate. A model is built from it once, is constant from then on, and is shared by any number of
   simulations in any number of threads. A simulation is all that changes: one thread at a time, a few MB each.

       trocar_scene *scene;  trocar_model *model;  trocar_sim *sim;  trocar_error why;  trocar_output out;
       trocar_scene_load("scene.yaml", &scene, &why);
       trocar_model_create(scene, NULL, &model, &why);
       trocar_sim_create(model, &sim, &why);
       trocar_sim_reset(sim, 0, &base, &why);
       trocar_sim_step(sim, 0, &base, 0.001, &out, &why);        out.force is what the hand feels

   Units are SI: m, N, N m, Pa, s, rad. The world frame is the mesh's; quaternions are w, x, y, z and of unit length; the
   needle's axis is its local +z from base to tip, its bevel faces local +y.

   Text: numbers are written and read with a decimal point, whatever the host's locale is, which stays as it is.

   Errors: functions that can fail return a status and leave one message in `error`, with the place and the remedy; `error` may
   be NULL. No function prints, exits or changes signals. What a function allocates is said with it; functions marked RT
   neither allocate, lock, call the system nor wait, and may run in a real-time thread.

   Floating point: calls that compute do so with denormals flushed to zero and restore the caller's mode. The first model sets
   OpenBLAS to one thread for the whole process: its threads would compete with yours, and results would depend on their
   number. One binary gives the same bits in every run on one kind of processor; between kinds, for which OpenBLAS has kernels of its own, results
   differ by 1e-12 of their peak. */
#ifndef TROCAR_H
#define TROCAR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define TROCAR_API __attribute__((visibility("default")))
#else
#define TROCAR_API
#endif

/* ---- version -------------------------------------------------------------------------------------------------------- */

#define TROCAR_MAJOR 0
#define TROCAR_MINOR 1
#define TROCAR_PATCH 0
#define TROCAR_NUMBER (10000 * TROCAR_MAJOR + 100 * TROCAR_MINOR + TROCAR_PATCH)

/* TROCAR_NUMBER of the library that is loaded: compare it with the header's. While the major version is 0, the minor one
   changes with the binary interface. RT */
TROCAR_API int trocar_version(void);

/* ---- errors ----------------------------------------------------------------------------------------------------------- */

typedef enum trocar_status {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, argument or file is wrong; programs exit with status 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a solve broke down */
    TROCAR_SYSTEM,     /* the operating system refused something */
    TROCAR_NO_REALTIME, /* of programs: the limits do not permit real time; they exit with status 4 */
    TROCAR_CANCELLED   /* the host wanted a long call to end: trocar_watch */
} trocar_status;

typedef struct trocar_error {
    char text[1024];
} trocar_error;

/* What a long call tells its host, and asks it, in the thread of the call. Both functions may be NULL. */
typedef struct trocar_watch {
    void (*progress)(const char *what, double fraction, void *context); /* 0 to 1 */
    int (*cancelled)(void *context);   /* not 0: the call ends soon, with CANCELLED */
    void *context;
} trocar_watch;

/* ---- values ------------------------------------------------------------------------------------------------------------- */

typedef struct trocar_pose {
    double position[3];      /* m */
    double orientation[4];   /* w x y z, unit: needle frame -> world */
} trocar_pose;

/* What happened in a tick: bits of trocar_output.events. */
enum {
    TROCAR_EVENT_TOUCHED = 1 << 0,    /* the tip met the outer surface */
    TROCAR_EVENT_PUNCTURED = 1 << 1,  /* a membrane gave way: trocar_output.membrane */
    TROCAR_EVENT_ADDED = 1 << 2,      /* a contact became active */
    TROCAR_EVENT_REMOVED = 1 << 3,    /* a contact slipped off the tip */
    TROCAR_EVENT_EXITED = 1 << 4,     /* the tip left the tissue on the far side */
    TROCAR_EVENT_REENTERED = 1 << 5,  /* and came back */
    TROCAR_EVENT_WITHDRAWN = 1 << 6,  /* the needle left the tissue the way it came in */
    TROCAR_EVENT_LATE = 1 << 7,       /* the worker has not answered for the tissue at the tip yet: the tick went on with what it had, or an estimate */
    TROCAR_EVENT_FULL = 1 << 8,       /* no contact is left to add (TROCAR_MAX_CONTACTS), or the track has more than 256 layers */
    TROCAR_EVENT_UNSTABLE = 1 << 9,   /* the result was not finite: the insertion starts over */
    TROCAR_EVENT_KEPT = 1 << 10,      /* no longer set */
    TROCAR_EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes a guide's plate outside of its holes, and is not guided: in every tick */
    TROCAR_EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is pushed into a body from the side, where it bears no force: in every tick */
    TROCAR_EVENT_TRACK_DROPPED = 1 << 13, /* no room for more tracks (TROCAR_MAX_TRACKS, TROCAR_MAX_TRACK_POINTS): the needle's oldest one is closed again */
    TROCAR_EVENT_INEXACT = 1 << 14    /* the tick ended after the most passes before they had converged: the wrench may be off by more than the tolerance */
};

enum { TROCAR_MAX_CONTACTS = 64, TROCAR_MAX_JOINTS = 65, TROCAR_MAX_NEEDLES = 32, TROCAR_MAX_GUIDES = 8 };
enum { TROCAR_MAX_POINTS = 2 * TROCAR_MAX_GUIDES + TROCAR_MAX_CONTACTS + 1 }; /* contacts of all kinds that take part */

/* One tick's result. */
typedef struct trocar_output {
    double force[3];         /* N, world frame: what the needle's base exerts on the hand that holds it */
    double torque[3];        /* N m, world frame, about the base point */
    double depth;            /* m, length of the needle's track in the tissue */
    int32_t contacts;        /* active contacts along the shaft, the tip not counted */
    uint32_t events;         /* TROCAR_EVENT_ bits */
    int32_t membrane;        /* index in the scene of the membrane punctured in this tick, -1 if none */
    int32_t passes;          /* Newton passes */
    int32_t switches;        /* contacts that changed between sticking and sliding while the tick was solved */
    int32_t reserved;        /* 0 */
} trocar_output;

typedef enum trocar_contact_kind {
    TROCAR_CONTACT_TISSUE = 0,
    TROCAR_CONTACT_TIP = 1,
    TROCAR_CONTACT_GUIDE = 2 /* the edge of a guide's hole, on one of its faces */
} trocar_contact_kind;

/* What a contact is doing. A tissue contact is planned, adding, then sticking or sliding until it is removed. */
typedef enum trocar_contact_status {
    TROCAR_CONTACT_PLANNED = 0,  /* ahead of the tip, which is not there yet */
    TROCAR_CONTACT_ADDING = 1,   /* the tip has passed; the worker has not answered yet. Both bear no force */
    TROCAR_CONTACT_STICKING = 2,
    TROCAR_CONTACT_SLIDING = 3,  /* trocar_contact.state: which way */
    TROCAR_CONTACT_DETACHED = 4  /* no longer used: a needle that buckles stays in contact */
} trocar_contact_status;

/* A point where the needle meets the tissue or a guide. */
typedef struct trocar_contact {
    int32_t kind;            /* trocar_contact_kind; more kinds may come */
    int32_t state;           /* 0 sticks, 1 slides forward, -1 slides backward */
    double arc;              /* m from the base, where it bears its force: of the tip, at the needle's end or behind it */
    double depth;            /* m along the track from the skin; 0 of a guide */
    double position[3];      /* m, on the deformed needle, world frame */
    double force[3];         /* N, on the tissue or guide, world frame */
    uint64_t id;             /* of a tissue contact: the same from its addition to its removal, and never used again for this needle; 0 of others */
    int32_t status;          /* trocar_contact_status */
    int32_t slot;            /* of a tissue contact: the same as long, 0 to TROCAR_MAX_CONTACTS - 1; free for another one later. Of a guide its index. -1 of the tip */
} trocar_contact;

/* A point of a track: where a needle has cut since it was reset. Tissue stays cut; any needle meets less resistance there. */
typedef struct trocar_track_point {
    double position[3];      /* m, in the tissue at rest */
    int32_t tet;             /* tetrahedron of the model's mesh that it is in */
    int32_t track;           /* from 0, oldest first; the points of one track follow each other from skin to tip, at most 4 mm apart */
    int32_t membrane;        /* index in the scene of the membrane that was punctured there, -1: none */
    int32_t reserved;        /* 0 */
} trocar_track_point;
enum { TROCAR_MAX_TRACKS = 128, TROCAR_MAX_TRACK_POINTS = 1024 }; /* of each needle: 4 m */

/* ---- scene ---------------------------------------------------------------------------------------------------------------- */

/* What a scene file says; see docs for its keys. Made by calls or from a file. Not thread-safe. */
typedef struct trocar_scene trocar_scene;

/* An empty scene: every key has its default; mesh, regions and fixed are to be given. Allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_scene_create(trocar_scene **scene, trocar_error *error);

/* Reads a YAML file. Allocates. BAD_INPUT with file, line and key. */
TROCAR_API trocar_status trocar_scene_load(const char *path, trocar_scene **scene, trocar_error *error);
TROCAR_API void trocar_scene_free(trocar_scene *scene); /* NULL is allowed, as in all *_free */

/* A second scene that says the same, with a mesh in memory of its own. Allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_scene_copy(const trocar_scene *scene, trocar_scene **copy, trocar_error *error);

/* Sets a key to a value written as in YAML: ("needle.length", "0.15"), ("fixed", "[back, below]"). An entry of a list is named by
   its index or its name, "regions[0].poisson_ratio" or "regions[prostate].friction.static"; an unknown name appends an entry.
   Paths are relative to the scene file, without one to the working directory. BAD_INPUT leaves the scene as it was. */
TROCAR_API trocar_status trocar_scene_set(trocar_scene *scene, const char *key, const char *value, trocar_error *error);
TROCAR_API trocar_status trocar_scene_set_number(trocar_scene *scene, const char *key, double value, trocar_error *error);

/* The value of a key, as in YAML, ended by 0. BAD_INPUT when there is no such key or entry or `size` bytes are too few. */
TROCAR_API trocar_status trocar_scene_get(const trocar_scene *scene, const char *key, char *value, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_scene_get_number(const trocar_scene *scene, const char *key, double *value, trocar_error *error);

/* The file that the scene was loaded from, as it was given; "" without one. Valid as long as the scene. */
TROCAR_API const char *trocar_scene_path(const trocar_scene *scene);

/* What the haptic device renders: the scene's keys "device.", for hosts that keep them. */
typedef struct trocar_device_limits {
    double max_stiffness;    /* N/m, of the virtual coupling; INFINITY: no coupling, the needle is held rigidly */
    double max_force;        /* N */
    double max_torque;       /* N m */
    double max_force_rate;   /* N/s */
    double max_torque_rate;  /* N m/s */
    double max_speed;        /* m/s, of the base point */
    double max_turn_rate;    /* rad/s */
    double hold_time;        /* s without a pose before the wrench is ramped down */
    double ramp_time;        /* s from the full wrench to none, and back */
    double mass;             /* kg, of device and hand at the handle; for the virtual coupling, which allows for half of it */
    double delay;            /* s, round trip between bridge and device: from a force until the positions that are read show it */
} trocar_device_limits;
TROCAR_API trocar_device_limits trocar_scene_device(const trocar_scene *scene);

/* Where the first needle's base waits before the insertion: the keys "needle.start.". Returns 1 and the pose, or 0 when there is none. */
TROCAR_API int trocar_scene_start(const trocar_scene *scene, trocar_pose *start);

/* From the patient's coordinates to the mesh's, as trocar_model_patient_to_mesh. Returns 1 and the matrix, or 0 when the scene has none. */
TROCAR_API int trocar_scene_patient_to_mesh(const trocar_scene *scene, double matrix[16]);

/* Limits of the key "rate_hz", Hz. */
#define TROCAR_MIN_RATE 250.0
#define TROCAR_MAX_RATE 10000.0

/* Entries of "regions", "membranes", "guides", "fixed" or "relaxation"; -1 for another key. */
TROCAR_API int trocar_scene_count(const trocar_scene *scene, const char *list);

/* A tetrahedral mesh in memory. Tetrahedra of either orientation are taken. */
typedef struct trocar_mesh {
    int32_t node_count, tet_count;
    const double *nodes;             /* 3 node_count, m */
    const int32_t *tets;             /* 4 tet_count, node indices from 0 */
    const int32_t *tet_region;       /* tet_count: index into `regions`; NULL: all are region 0 */
    int32_t region_count;
    const char *const *regions;      /* names */
    int32_t triangle_count;          /* triangles of named surfaces: faces of tetrahedra */
    const int32_t *triangles;        /* 3 triangle_count */
    const int32_t *triangle_surface; /* triangle_count: index into `surfaces` */
    int32_t surface_count;
    const char *const *surfaces;     /* names: for membranes and `fixed` */
} trocar_mesh;

/* Takes the mesh from arrays in place of a file; copies them. BAD_INPUT for indices out of range and the like; whether
   the mesh is sound is found when the model is created. */
TROCAR_API trocar_status trocar_scene_set_mesh(trocar_scene *scene, const trocar_mesh *mesh, trocar_error *error);

/* How a key's value is written. */
typedef enum trocar_key_kind {
    TROCAR_KEY_NUMBER = 0,
    TROCAR_KEY_TEXT = 1,     /* a word, name or path */
    TROCAR_KEY_NUMBERS = 2,  /* a list of numbers */
    TROCAR_KEY_NAMES = 3     /* a list of names */
} trocar_key_kind;

/* The reference table of keys, from which documentation is made. The strings live as long as the program. */
typedef struct trocar_key {
    const char *key;         /* "regions[].friction.static": one for each entry of the list */
    const char *unit;        /* "" where there is none */
    const char *accepts;     /* "a number above 0" */
    const char *standard;    /* default, "" where there is none */
    const char *doc;
    int required;
    int32_t kind;            /* trocar_key_kind */
} trocar_key;
TROCAR_API int trocar_key_count(void);
TROCAR_API trocar_key trocar_key_at(int index); /* all empty when out of range */

/* ---- model -------------------------------------------------------------------------------------------------------------------- */

/* Mesh, stiffness, inverse, needle and materials: constant, shared by threads without a lock, but for the sparse inverse and
   what lies outside a condensed one's region, which take turns. */
typedef struct trocar_model trocar_model;

typedef struct trocar_model_options {
    void (*progress)(const char *what, double fraction, void *context); /* 0..1, while a long start goes on; may be NULL. Must not wait for another model to be made */
    void *context;
    int longest_catch_up;    /* steps of at most 1 ms that a long tick is split into; 0: the usual 4 */
    int mesh_only;           /* 1: reads and checks the mesh and the names in it, and stops there: for viewers. Such a model has
                                no stiffness, and no simulation can be created from it */
    int keep_inverse;        /* 1: a condensed inverse that cannot be saved in the cache is an error (SYSTEM), found before it is made */
    int (*cancelled)(void *context); /* asked meanwhile, in the same thread; not 0: the call ends soon, with CANCELLED. Reading a mesh and factorising are
                                not interrupted: seconds at 20 000 nodes. May be NULL */
} trocar_model_options;

/* Builds everything; `options` may be NULL. Seconds for thousands of nodes, minutes for tens of thousands unless the condensed
   inverse is in the cache. Above 30 000 unknowns condensing has as many threads as BLAS by default. For a dense or sparse inverse, BLAS has
   that many meanwhile, in all threads of the process, and one from then on: simulations that run and models that are made beside it may be slower
   and differ in their last bits; a second inverse of this kind waits. Allocates 8 (3 n)^2 bytes for a dense inverse of n nodes.
   Uses Gmsh to read a mesh file: inside a host that uses Gmsh itself the host's session stays as it is; call it from one thread then. Starting, Gmsh
   sets the process's locale for a moment: other threads should not format numbers just then. The scene is not needed
   afterwards. BAD_INPUT, NO_MEMORY, NUMERIC, SYSTEM, CANCELLED. */
TROCAR_API trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model,
                                             trocar_error *error);
TROCAR_API void trocar_model_free(trocar_model *model); /* its memory goes with the last simulation, picture or derived model that uses it */

/* A model of another scene that shares the mesh, stiffness and inverse of `base`: milliseconds, and a little
   memory. The scenes may differ in needle, friction, cutting, membranes' strength, stiffening, relaxation, guides, contacts and seeds.
   BAD_INPUT, with the key, if mesh, stiffness or inverse would be others, and for meshes that came as arrays; NO_MEMORY. */
TROCAR_API trocar_status trocar_model_derive(const trocar_model *base, const trocar_scene *scene, trocar_model **model, trocar_error *error);

/* All strings and arrays are the model's and live as long as it does. */
TROCAR_API const char *trocar_model_inverse(const trocar_model *model);        /* "dense", "sparse" or "condensed"; "" with mesh_only */
TROCAR_API const char *trocar_model_description(const trocar_model *model);    /* which inverse was chosen, and why */
TROCAR_API const char *trocar_model_remarks(const trocar_model *model);        /* what was repaired in the mesh, or looks wrong in it; "": nothing */
TROCAR_API int trocar_model_unknowns(const trocar_model *model);               /* three for each node that is not fixed */
TROCAR_API int trocar_model_needles(const trocar_model *model);                /* needles of the scene */
TROCAR_API int trocar_model_segments(const trocar_model *model);               /* of the needle: it has one joint more */
TROCAR_API double trocar_model_needle_length(const trocar_model *model);       /* m */
TROCAR_API double trocar_model_rate(const trocar_model *model);                /* Hz, rate_hz of the scene */

/* Where the first needle's base waits before the insertion: the scene's keys "needle.start.". Returns 1 and the pose, or 0 when the scene
   has none. */
TROCAR_API int trocar_model_start(const trocar_model *model, trocar_pose *start);

/* From the patient's coordinates (DICOM's: mm to the left, back and head) to the mesh's (m): the scene's key "patient_to_mesh", row by
   row; its upper left 3 x 3 is a rotation times 1e-3. Returns 1 and the matrix, or 0 when the scene has none. */
TROCAR_API int trocar_model_patient_to_mesh(const trocar_model *model, double matrix[16]);

/* The mesh at rest. Its named groups, here called regions, have a dimension: 3 for volumes, 2 for surfaces, 1 and 0 for curves and points. */
TROCAR_API int trocar_model_node_count(const trocar_model *model);
TROCAR_API int trocar_model_tet_count(const trocar_model *model);
TROCAR_API const double *trocar_model_nodes(const trocar_model *model);        /* 3 node_count, m */
TROCAR_API const int32_t *trocar_model_tets(const trocar_model *model);        /* 4 tet_count, positive volume */
TROCAR_API const int32_t *trocar_model_neighbours(const trocar_model *model);  /* 4 tet_count: tetrahedron across the face opposite each corner, -1: none */
TROCAR_API const int32_t *trocar_model_tet_regions(const trocar_model *model); /* tet_count: index of the volume */
TROCAR_API const uint32_t *trocar_model_face_surfaces(const trocar_model *model); /* 4 tet_count: bit i is set where the face lies on region i, a surface */
TROCAR_API const uint8_t *trocar_model_fixed(const trocar_model *model);       /* node_count: 1 where held at zero displacement; NULL with mesh_only */
TROCAR_API int trocar_model_region_count(const trocar_model *model);           /* of any dimension, at most 32 */
TROCAR_API const char *trocar_model_region_name(const trocar_model *model, int index); /* "" when out of range */
TROCAR_API int trocar_model_region_dimension(const trocar_model *model, int index);    /* -1 when out of range */
TROCAR_API int trocar_model_find_region(const trocar_model *model, const char *name, int dimension); /* index, or -1 */

/* Where the segment between two points (m) first enters the tissue at rest. Returns 1 and the point, or 0 when it never does. RT */
TROCAR_API int trocar_model_entry(const trocar_model *model, const double from[3], const double to[3], double point[3]);

/* What a volume is made of: the scene's keys "regions[]." of the same names. All zero when it is no volume. */
typedef struct trocar_material {
    double youngs_modulus;    /* Pa */
    double poisson_ratio;
    double cutting_force;     /* N; INFINITY: bone */
    double cutting_viscosity; /* N s/m */
    double friction_static;   /* N/m */
    double friction_kinetic;  /* N/m */
    double friction_viscous;  /* N s/m^2 */
    double spreading_force;   /* N */
    double stiffening;        /* C20 / C10 of a Yeoh material */
} trocar_material;
TROCAR_API trocar_material trocar_model_material(const trocar_model *model, int region);

/* A guide of the scene, the key "guides[]". Hole (column, row), from 0, has its axis at origin + (column - (columns - 1) / 2) spacing
   across[0] + (row - (rows - 1) / 2) spacing across[1] on the front face. */
typedef struct trocar_guide {
    double origin[3];        /* m, middle of the holes on the front face */
    double normal[3];        /* unit vectors: through the plate, */
    double across[2][3];     /* along columns, and rows: perpendicular; left- or right-handed with the normal */
    double spacing;          /* m */
    double hole_diameter;    /* m */
    double thickness;        /* m */
    int32_t columns, rows;
} trocar_guide;
TROCAR_API int trocar_model_guide_count(const trocar_model *model);
TROCAR_API trocar_guide trocar_model_guide(const trocar_model *model, int index); /* all zero when out of range */

/* The scene's ultrasound probe, the keys "probe.": a cylinder along its local +z, from its base, where the hand holds it, to its tip at z = length.
   Returns 1 and the probe, or 0 when the scene has none. */
typedef struct trocar_probe_shape {
    double radius;           /* m */
    double tip_radius;       /* m, of the rounded edge at its end */
    double length;           /* m, from base to tip */
    int32_t surface;         /* index of the region, a surface, that it presses */
    int32_t reserved;        /* 0 */
} trocar_probe_shape;
TROCAR_API int trocar_model_probe(const trocar_model *model, trocar_probe_shape *shape);

/* Where the probe's base is to begin: the keys "probe.start.". Returns 1 and the pose, or 0 when the scene has none. */
TROCAR_API int trocar_model_probe_start(const trocar_model *model, trocar_pose *start);

/* How volumetric strains are averaged (key "volumetric_strain"). 1 if around nodes, else 0. */
TROCAR_API int trocar_model_averages_strain(const trocar_model *model);

/* If they are averaged over patches of tetrahedra: tet_count patch numbers from 0 on, one for each tetrahedron; else, and with mesh_only, NULL. */
TROCAR_API const int32_t *trocar_model_strain_patches(const trocar_model *model);

/* Makes now what would else be made when it is first needed: the factor for contacts outside a condensed inverse's region, a minute and gigabytes on
   a large mesh. From any
   thread, beside the others. Allocates. */
TROCAR_API trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error);

/* ---- simulation ------------------------------------------------------------------------------------------------------------------ */

/* The needles and what they do to the tissue. `needle` is the index of one: 0 to trocar_model_needles() - 1.

   Several needles are ticked one after another, each with its own pose, by one thread. Each feels how the others displace the
   tissue, as of its last answer from the worker: in lockstep one step late, in real time as late as the worker, with changes of
   a force below 1 mN left out. All follow the tracks that any of them has cut. What is neglected: needles do not touch each other,
   and needles in the same element of the mesh do not share the contact nodes in it.

   A needle that is left rests: its base is free, and tissue and guides keep it where it is. What it costs a tick does not depend on how many
   rest. Resting needles respond to what others do to the tissue as they do linearised about the equilibrium in which they were left,
   and where friction gives way they slip, at 250 Hz (100 Hz while a probe presses). */
typedef struct trocar_sim trocar_sim;

/* Every needle is straight, with its base at the origin, until it is reset. Allocates all that a simulation will need but the
   scratch of displacements. NO_MEMORY. */
TROCAR_API trocar_status trocar_sim_create(trocar_model *model, trocar_sim **sim, trocar_error *error);
TROCAR_API void trocar_sim_free(trocar_sim *sim);

/* The needle straight at `base`, and the tissue as if it had never been there: without its tracks, and without what relaxing tissue
   remembers of its forces. What other needles did stays, and so do seeds; those that are still in the needle stay in it. Where it lies in the tissue it counts as inserted along its
   axis, without force.
   One that rests is gone from the tissue.
   BAD_INPUT for a needle that is none and for a pose that is not finite or not of unit length (1e-3). RT, but for one write() to an
   eventfd. */
TROCAR_API trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error);

/* Lockstep, for planners and batches: a tick of `dt` seconds (above 0, at most 1), then the mesh update that it asked for, so that
   the next tick has it. Deterministic. Needles that were to be left or taken are so before the tick. BAD_INPUT as in reset, and for a
   needle that rests; NUMERIC when the mesh update fails. If the result is not finite, the
   insertion starts over as in trocar_sim_tick, and the status is OK. */
TROCAR_API trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output,
                                         trocar_error *error);

/* Real time: the same tick with the newest answer of the worker. BAD_INPUT, and nothing is done, as in reset, and for a needle that rests or
   that the worker has not handed over yet. NUMERIC when the
   result was not finite: the insertion has been reset at `base`, and the output is zero but for TROCAR_EVENT_UNSTABLE. RT, but for
   one write() to an eventfd when there is something new to ask of the worker. */
TROCAR_API trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);

/* Leaves a needle: the hand lets go of it, its base moves until no force is left on it (1 mN), and there it rests. The worker does that,
   or in lockstep the next trocar_sim_step (of any needle) or trocar_sim_work; until then the needle is LEAVING. What other needles that are
   held feel of it is spread over 0.1 s of their ticks. If it finds no equilibrium, that call fails, and the needle is HELD as before. Around a
   needle that rests, relaxing tissue stays as it is, and goes on to relax when the needle is taken. BAD_INPUT for a needle that is none, is not in
   the tissue, is on its way to another shape or rests already, and with a method of remeshing other than nested and implicit. RT, but for one write() to an
   eventfd, and a copy of 150 kB. */
TROCAR_API trocar_status trocar_sim_leave(trocar_sim *sim, int needle, trocar_error *error);

/* Takes a needle that rests: it is TAKING until the worker, or in lockstep the next step, has handed it over. The first tick's pose should be
   trocar_sim_base(), where the base then is. BAD_INPUT for a needle that is none or does not rest. RT, but for one write() to an
   eventfd. */
TROCAR_API trocar_status trocar_sim_take(trocar_sim *sim, int needle, trocar_error *error);

typedef enum trocar_needle_state {
    TROCAR_NEEDLE_HELD,      /* by whoever ticks it; and outside of the tissue */
    TROCAR_NEEDLE_LEAVING,
    TROCAR_NEEDLE_RESTING,
    TROCAR_NEEDLE_TAKING
} trocar_needle_state;

/* HELD for a needle that is none. Ticking thread. RT */
TROCAR_API trocar_needle_state trocar_sim_needle_state(const trocar_sim *sim, int needle);

/* Holds the base by a spring of this compliance, m/N, whose other end is at the pose given to each tick; 0, the default: rigidly.
   Stays until it is set again. For a host with a virtual coupling: solved together with the needle, the spring may be as stiff as it
   likes. RT */
TROCAR_API void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance);

/* Where the base is: at the last pose given, moved by what the spring has yielded; of a needle that rests, where it has come to. RT */
TROCAR_API trocar_pose trocar_sim_base(const trocar_sim *sim, int needle);

/* Moves the probe. It presses its surface without friction, and never pulls; needles feel how it displaces and holds the tissue. It stops where
   the force would exceed the scene's probe.max_force, and goes on once a pose leads it back.
   The worker solves for that, at least 50 times a second if asked as often; in lockstep the next trocar_sim_step does, before its tick. The
   newest pose counts. Keeps up with needles as those that rest do: what they push against it is found at 100 Hz. BAD_INPUT, and it stays
   where it was, for a pose as in reset and if the scene has no probe. RT, but for one write() to an eventfd. */
TROCAR_API trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error);

/* The probe as it was solved for last. */
typedef struct trocar_probe {
    trocar_pose base;
    double force[3];         /* N, world frame: what the probe exerts on the hand that holds it */
    double torque[3];        /* N m, world frame, about the base point */
    int32_t contacts;        /* points of the surface that it presses, nodes and middles of edges; at most TROCAR_MAX_PRESSED */
    int32_t placed;          /* 0: the scene has no probe, or no pose has been given yet that it could take; all else but `stopped` is 0 then */
    int32_t stopped;         /* 1: the tissue keeps it from the pose given last, and it rests at `base`: its force would exceed the scene's
                                probe.max_force, or it came by a leap and its axis would lie in the tissue */
    int32_t reserved;        /* 0 */
} trocar_probe;
enum { TROCAR_MAX_PRESSED = 256 };

/* Ticking thread. RT */
TROCAR_API trocar_probe trocar_sim_probe(const trocar_sim *sim);

/* What a call of trocar_sim_work did. */
typedef struct trocar_work {
    int32_t answered;        /* 1: it answered a request, 0: there was none */
    int32_t more;            /* 1: it pays to call again at once */
    int32_t kept;            /* 1: a needle that was to be left finds no equilibrium without the hand (NUMERIC), or slips out of the tissue (BAD_INPUT): it is held as before */
    int64_t latency;         /* ns from that request to its answer, by the simulation's clock; 0 without a clock */
} trocar_work;

/* The worker's side, from one thread beside the ticking one: serves the newest request, if there is one, else looks a little
   ahead along the needle's line. `work` may be NULL. May take long. Allocates when a needle is left or taken, and when
   the probe presses other nodes, else nothing but what a
   sparse inverse keeps. On an error (NO_MEMORY, NUMERIC) the last answer stays in force. */
TROCAR_API trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *work, trocar_error *error);

/* ns since the oldest request that the tick has no answer to yet, by the simulation's clock; 0 when all are answered. Ticking
   thread. RT */
TROCAR_API int64_t trocar_sim_waiting(const trocar_sim *sim);

/* A descriptor for poll(): readable when a request waits. The simulation's. */
TROCAR_API int trocar_sim_work_descriptor(const trocar_sim *sim);

/* All that changes, as a block of `trocar_sim_state_size` bytes in the caller's memory: valid for any simulation of the same model, in
   this process. Between lockstep steps only. What follows a restore is what followed the save: to the bit with `remeshing: nested` on
   a dense or condensed inverse where no needle rests, else to rounding. Restore allocates nothing where none rests. BAD_INPUT for a wrong size or another model's. */
TROCAR_API size_t trocar_sim_state_size(const trocar_sim *sim);
TROCAR_API trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error);

/* Contacts that take part, with tissue and with guides that the needle touches, from base to tip, the tip last if it is in the tissue. Fills at most `room` and returns how many there are, at most TROCAR_MAX_POINTS. RT */
TROCAR_API int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room);

/* The tissue contacts that do not take part yet, from base to tip: status PLANNED, at most one, the last, or ADDING. The position of a
   planned one is its place in the tissue at rest, and its arc the needle's length. As trocar_sim_contacts. RT */
TROCAR_API int trocar_sim_pending_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room);

/* The hole of a guide that the needle is in: column + columns * row, from 0. TROCAR_NO_HOLE: not at the guide or beside its plate;
   TROCAR_MISSED_HOLE: through the plate outside of the holes (TROCAR_EVENT_MISSED_GUIDE). RT */
enum { TROCAR_NO_HOLE = -1, TROCAR_MISSED_HOLE = -2 };
TROCAR_API int trocar_sim_hole(const trocar_sim *sim, int needle, int guide);

/* The tracks that this needle has cut since it was reset. Fills at most `room` points and returns how many there are, at most
   TROCAR_MAX_TRACK_POINTS. RT */
TROCAR_API int trocar_sim_tracks(const trocar_sim *sim, int needle, trocar_track_point *points, int room);

/* Joints of the needle from base to tip, 3 numbers each, m. Fills at most `room` joints and returns how many there are. RT */
TROCAR_API int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room);

/* Turn of the tip about the needle's axis less that of the base, rad: friction in the tissue twists the needle, so that the tip of one that is
   turned forward lags, which is negative. RT */
TROCAR_API double trocar_sim_tip_lead(const trocar_sim *sim, int needle);

/* Elastic energy of the bent needle, J. RT */
TROCAR_API double trocar_sim_needle_energy(const trocar_sim *sim, int needle);

/* Displacement of the mesh's nodes, 3 node_count, m. One solve with the whole matrix: milliseconds to tenths of a second. The
   first call allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_sim_displacements(trocar_sim *sim, double *displacements, trocar_error *error);

/* ---- seeds --------------------------------------------------------------------------------------------------------------------------- */

/* A seed of brachytherapy: a material point of the tissue with a direction. It moves with the tissue and stays when the needles are
   reset or out. A marker: it neither stiffens the tissue, nor is it dragged along by the needle that leaves. */
typedef struct trocar_seed {
    double position[3];      /* m, its centre in the tissue at rest */
    double direction[3];     /* unit vector from its proximal end to its distal one, likewise */
    double weights[4];       /* barycentric, of its centre in the tetrahedron `tet` */
    int32_t tet;             /* of the model's mesh */
    int32_t needle;          /* that left it */
    int32_t guide, hole;     /* the needle was in this hole, column + columns * row, of this guide; -1: in none */
    int32_t strand;          /* number in its strand, 0: the distal one */
    int32_t reserved;        /* 0 */
} trocar_seed;
enum { TROCAR_MAX_SEEDS = 256, TROCAR_MAX_STRAND = 16 };

/* The scene's keys "seeds.", m. */
typedef struct trocar_seed_size {
    double length, diameter;
    double spacing;          /* of a strand, between the centres of neighbouring seeds */
} trocar_seed_size;
TROCAR_API trocar_seed_size trocar_model_seed_size(const trocar_model *model);

/* Drops a seed, or a strand of `count`, 1 to TROCAR_MAX_STRAND, `spacing` apart from centre to centre (m, at least a seed's length; 0: the
   scene's). The tip is now at the distal end of the first seed. The mandrin holds the seeds there while the needle is drawn back: each
   is left in the tissue, in a straight line along the needle's track, once the tip has passed its proximal end.
   BAD_INPUT, and nothing changes: for a needle that is none, a wrong count or spacing, a tip outside of the tissue or not deep
   enough in it for the whole strand, while seeds of this needle are pending, if there would be more than TROCAR_MAX_SEEDS, and where the scene's
   seeds are thicker than its needle. Between ticks, from the ticking thread. RT */
TROCAR_API trocar_status trocar_sim_drop_seeds(trocar_sim *sim, int needle, int count, double spacing, trocar_error *error);

/* Takes back what is pending of the needle's last drop; if nothing is, removes the seed that this needle has left last. BAD_INPUT if there is
   none, and for a needle that is none. Between ticks, from the ticking thread. RT */
TROCAR_API trocar_status trocar_sim_undo_seed(trocar_sim *sim, int needle, trocar_error *error);

/* The seeds in the tissue, in the order in which they were left. Fills at most `room` and returns how many there are, at most
   TROCAR_MAX_SEEDS. RT */
TROCAR_API int trocar_sim_seeds(const trocar_sim *sim, trocar_seed *seeds, int room);

/* Seeds that were dropped and that the needle has not been drawn back over. RT */
TROCAR_API int trocar_sim_pending_seeds(const trocar_sim *sim, int needle);

/* Where a seed is in the displaced tissue: its centre (m), and its direction turned with the tissue around it. `displacements`: as from
   trocar_sim_displacements or trocar_picture_displacements. Returns 1, or 0 for a seed that is in no tetrahedron of the model. RT */
TROCAR_API int trocar_model_displace_seed(const trocar_model *model, const double *displacements, const trocar_seed *seed, double position[3],
                                          double direction[3]);

/* ---- measuring ----------------------------------------------------------------------------------------------------------------------- */

/* The clock of this simulation: monotonic ns, called from the ticking thread and the worker's; NULL, the default: nothing is
   measured. Set it before both start. */
TROCAR_API void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void));

/* ns spent in the stages of the last tick. RT */
enum { TROCAR_STAGE_TISSUE, TROCAR_STAGE_NEEDLE, TROCAR_STAGE_CONTACT, TROCAR_STAGE_WRENCH, TROCAR_STAGES };
TROCAR_API void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[4]);

/* ---- pictures --------------------------------------------------------------------------------------------------------------------- */

/* A copy of what there is to see of a simulation after a tick: needle, contacts, forces. Taken by the ticking thread, it can be
   handed to another one, which then has all the time it needs for the displacements. One thread at a time. */
typedef struct trocar_picture trocar_picture;

/* An empty picture: needle straight at the origin. Allocates, up to 150 kB a needle. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_create(trocar_model *model, trocar_picture **picture, trocar_error *error);
TROCAR_API void trocar_picture_free(trocar_picture *picture);

/* Copies up to 150 kB a needle. Simulation and pictures must be of one model. RT */
TROCAR_API void trocar_sim_take_picture(const trocar_sim *sim, trocar_picture *picture);
TROCAR_API void trocar_picture_copy(const trocar_picture *from, trocar_picture *to);

/* As trocar_sim_contacts, trocar_sim_tracks, trocar_sim_centreline, trocar_sim_base and trocar_sim_tip_lead. RT */
TROCAR_API int trocar_picture_contacts(const trocar_picture *picture, int needle, trocar_contact *contacts, int room);
TROCAR_API int trocar_picture_tracks(const trocar_picture *picture, int needle, trocar_track_point *points, int room);
TROCAR_API int trocar_picture_centreline(const trocar_picture *picture, int needle, double *joints, int room);
TROCAR_API trocar_pose trocar_picture_base(const trocar_picture *picture, int needle);
TROCAR_API double trocar_picture_tip_lead(const trocar_picture *picture, int needle);

/* As trocar_sim_seeds and trocar_sim_pending_seeds. RT */
TROCAR_API int trocar_picture_seeds(const trocar_picture *picture, trocar_seed *seeds, int room);
TROCAR_API int trocar_picture_pending_seeds(const trocar_picture *picture, int needle);

/* As trocar_sim_probe. RT */
TROCAR_API trocar_probe trocar_picture_probe(const trocar_picture *picture);

/* As trocar_sim_displacements: the first call allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_displacements(trocar_picture *picture, double *displacements, trocar_error *error);

/* The refined mesh: nodes of the model's mesh, then the contact nodes. Stiffness times displacements = forces at all nodes that
   are not fixed. The arrays are the picture's, until its next call or its end. */
typedef struct trocar_refined_mesh {
    int32_t node_count, tet_count;
    const double *nodes;         /* 3 node_count, m, at rest */
    const int32_t *tets;         /* 4 tet_count */
    const int32_t *parents;      /* tet_count: tetrahedron of the model's mesh that each is a part of */
    const double *displacements; /* 3 node_count, m */
    const double *forces;        /* 3 node_count, N, on the tissue */
    double damping[3];           /* N, part of `forces` that the needle does not feel: it holds back tissue that springs back at the tip */
} trocar_refined_mesh;

/* Allocates; costs one call of trocar_picture_displacements. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_refined_mesh(trocar_picture *picture, trocar_refined_mesh *mesh, trocar_error *error);

/* ---- batches ------------------------------------------------------------------------------------------------------------------------ */

/* Runs `batch` insertions of `steps` ticks of `dt` seconds, each in a simulation of its own that is reset at its first pose;
   poses, of needle 0, and outputs are [batch][steps]. `threads` of them at a time. Allocates one simulation a thread. With
   `remeshing: nested` on a dense or condensed inverse the bits do not depend on the number of threads. On an error the
   outputs of that insertion are zero from there on and the first message is returned; the other insertions are finished. */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, double dt, int threads,
                                        trocar_output *outputs, trocar_error *error);

/* The same with a watch, that may be NULL: told and asked every 64 ticks. CANCELLED: outputs of what had not been done yet are zero. */
TROCAR_API trocar_status trocar_rollout_watched(trocar_model *model, const trocar_pose *poses, int batch, int steps, double dt, int threads,
                                                const trocar_watch *watch, trocar_output *outputs, trocar_error *error);

/* A trocar_sim_step for each of `steps` poses, with a watch as above. On an error the message names the step, and outputs are zero from there
   on. */
TROCAR_API trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch,
                                        trocar_output *outputs, trocar_error *error);

/* ---- dose --------------------------------------------------------------------------------------------------------------------------- */

/* Dose of brachytherapy seeds by the line-source formula of AAPM TG-43U1 (Rivard et al., Med. Phys. 31, 2004), as if the patient were
   water and seeds did not shade each other:

       rate(r, theta) = S_K Lambda G(r, theta) / G(1 cm, 90 degrees) g(r) F(r, theta)

   Tables are interpolated as TG-43U1S1 (2007) recommends: g log-linear, also beyond its last radius, and constant before its first; F
   bilinear, and that of the nearest radius outside. Inside of a seed's capsule the formula has no meaning; the value is that of the closest point
   beside it on its side wall.

   Doses are in Gy, dose rates in Gy/h, air-kerma strengths in U (1 U = 1 cGy cm^2/h = 1 uGy m^2/h). None of these functions needs a scene
   or a model, has global state, or depends on the host's locale. Sources and structures are constant and shared by any number of threads. */

/* A seed model: the TG-43 data of one kind of seed. Constant. */
typedef struct trocar_dose_source trocar_dose_source;

/* A seed model by its name: "I-125 6711" or "Pd-103 200", consensus data of TG-43U1. Allocates. BAD_INPUT for another name; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_source_create(const char *name, trocar_dose_source **source, trocar_error *error);

/* A seed model from a table in YAML; docs/dose.md has its keys. Allocates. BAD_INPUT with file, line and remedy, also for gaps, for radii or
   angles that do not grow, and for g or F that are not 1 where they are by definition; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_source_load(const char *path, trocar_dose_source **source, trocar_error *error);
TROCAR_API void trocar_dose_source_free(trocar_dose_source *source); /* after the doses that use it */

typedef struct trocar_dose_source_data {
    char name[64];
    double dose_rate_constant;   /* Lambda, cGy/(h U) */
    double active_length;        /* m, of the line source */
    double capsule_length, capsule_diameter; /* m, outside */
    double half_life;            /* s */
} trocar_dose_source_data;
TROCAR_API trocar_dose_source_data trocar_dose_source_get(const trocar_dose_source *source); /* RT */

/* Dose over the first `hours` of decay, divided by the initial dose rate: h. INFINITY, a permanent implant: the half-life / ln 2. NAN for
   a negative number. RT */
TROCAR_API double trocar_dose_hours(const trocar_dose_source *source, double hours);

typedef struct trocar_dose_seed {
    double position[3];          /* m, the seed's centre */
    double direction[3];         /* along its axis, of any length but 0 */
    double strength;             /* U, air-kerma strength at the implantation, above 0, at most 1000 */
} trocar_dose_seed;

/* Dose rates (Gy/h) of `seed_count` seeds at `count` points [count][3] (m): the plain sum of the formula in floating point. 25 ns a
   point and seed. BAD_INPUT, and nothing is written, for a seed or point that is not finite or beyond 1000 m, or a bad strength or
   direction. RT */
TROCAR_API trocar_status trocar_dose_rates(const trocar_dose_source *source, const trocar_dose_seed *seeds, int seed_count, const double *points,
                                           int64_t count, double *rates, trocar_error *error);

/* The dose of a permanent implant at many points: those of a grid, or any. One thread at a time.

   Doses are kept as whole multiples of TROCAR_DOSE_QUANTUM. Sums are therefore exact: they do not depend on the order in which seeds come and
   go, and removing a seed leaves every point as if it had never been there, to the bit. A seed's contribution is rounded to the nearest
   multiple, and cut at TROCAR_DOSE_MOST. */
typedef struct trocar_dose trocar_dose;
#define TROCAR_DOSE_QUANTUM 5.8207660913467407e-11 /* Gy: 2^-34 */
#define TROCAR_DOSE_MOST 131072.0                  /* Gy, of one seed at one point: 2^17 */
enum { TROCAR_MAX_DOSE_SEEDS = 4095 };

/* Voxel (i, j, k), each from 0, has the index (i counts[1] + j) counts[2] + k, and its centre at origin + spacing (i, j, k). */
typedef struct trocar_dose_grid {
    double origin[3];            /* m, centre of voxel (0, 0, 0) */
    double spacing;              /* m, above 0 */
    int32_t counts[3];           /* voxels along x, y and z: at least 1, at most 2^28 in total */
} trocar_dose_grid;

/* No dose yet. Allocates 8 bytes a voxel of the grid, or 32 a point. The source must outlive it; points [count][3], m, are copied, at most
   2^28. BAD_INPUT for a bad grid or point; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_create(const trocar_dose_source *source, const trocar_dose_grid *grid, trocar_dose **dose, trocar_error *error);
TROCAR_API trocar_status trocar_dose_create_points(const trocar_dose_source *source, const double *points, int64_t count, trocar_dose **dose,
                                                   trocar_error *error);
TROCAR_API void trocar_dose_free(trocar_dose *dose);

/* Adds a seed; `id` (may be NULL) names it from then on, and is never given again. 25 ns a point. Allocates a little for the list of seeds.
   BAD_INPUT as in trocar_dose_rates, and beyond TROCAR_MAX_DOSE_SEEDS seeds; NO_MEMORY. On an error nothing has changed. */
TROCAR_API trocar_status trocar_dose_add(trocar_dose *dose, const trocar_dose_seed *seed, int32_t *id, trocar_error *error);

/* Takes a seed out, or gives it another place, direction and strength: as long as one addition, or two. BAD_INPUT for an id that is none, and for
   a bad seed; then nothing has changed. RT */
TROCAR_API trocar_status trocar_dose_remove(trocar_dose *dose, int32_t id, trocar_error *error);
TROCAR_API trocar_status trocar_dose_move(trocar_dose *dose, int32_t id, const trocar_dose_seed *seed, trocar_error *error);

/* Puts every point at its place at rest plus its displacement [count][3], m; NULL: back at rest. Seeds stay where they are: for deformed anatomy
   move them too. Computes all seeds anew. Allocates 24 bytes a point the first time. BAD_INPUT for a displacement that is not finite or a
   point beyond 1000 m, and nothing has changed; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_displace(trocar_dose *dose, const double *displacements, trocar_error *error);

TROCAR_API int64_t trocar_dose_point_count(const trocar_dose *dose);   /* RT */
TROCAR_API int trocar_dose_seed_count(const trocar_dose *dose);        /* RT */
TROCAR_API void trocar_dose_values(const trocar_dose *dose, double *values); /* Gy, of all points. RT */

/* The voxels whose centres, multiples of the spacing plus one half, are inside of an organ at rest. Constant. */
typedef struct trocar_structure trocar_structure;

/* Inside of a closed surface: the triangles whose triangle_surface is `surface`, or all of them if that is NULL. Every edge must
   belong to an even number of triangles; their orientation does not matter. Needs of `mesh`: nodes and triangles. `spacing` in m, above 0.
   Allocates, meanwhile 1 byte a voxel of the surface's box. BAD_INPUT for an open surface, with an edge, for one without triangles or
   voxels, for an index out of range, and for more than 2^28 voxels in the box; NO_MEMORY. */
TROCAR_API trocar_status trocar_structure_from_surface(const trocar_mesh *mesh, int surface, double spacing, trocar_structure **structure,
                                                       trocar_error *error);

/* Inside of the tetrahedra whose tet_region is `region`, or of all of them if that is NULL. Needs of `mesh`: nodes and tetrahedra, as
   trocar_model_nodes, trocar_model_tets and trocar_model_tet_regions give them. Allocates, meanwhile 4 bytes a voxel of the region's box. Errors
   as above. */
TROCAR_API trocar_status trocar_structure_from_region(const trocar_mesh *mesh, int region, double spacing, trocar_structure **structure,
                                                      trocar_error *error);
TROCAR_API void trocar_structure_free(trocar_structure *structure);
TROCAR_API int64_t trocar_structure_count(const trocar_structure *structure);         /* voxels, at least 1. RT */
TROCAR_API const double *trocar_structure_points(const trocar_structure *structure);  /* [count][3], m, their centres; the structure's. RT */
TROCAR_API double trocar_structure_voxel(const trocar_structure *structure);          /* m^3, volume of a voxel. RT */

/* Displacements [count][3] of the voxels' centres, interpolated from those of the mesh's nodes, [node_count][3] (m), as
   trocar_sim_displacements gives them: for trocar_dose_displace. BAD_INPUT for a structure that was made from a surface. RT */
TROCAR_API trocar_status trocar_structure_displacements(const trocar_structure *structure, const double *nodal, double *displacements,
                                                        trocar_error *error);

/* Cumulative dose-volume histogram of voxels of equal size. First sorts the doses in place, largest first; BAD_INPUT for one that is not
   finite or for less than one. The other functions take sorted doses, `count` at least 1. */
TROCAR_API trocar_status trocar_dvh_sort(double *doses, int64_t count, trocar_error *error);

/* The dose (Gy) that the fraction 0 to 1 of the volume gets at least, between voxels by linear interpolation: 0.9 for D90. RT */
TROCAR_API double trocar_dvh_dose(const double *doses, int64_t count, double fraction);

/* The fraction of the volume that gets `dose` (Gy) or more: the prescription for V100, 1.5 times that for V150. RT */
TROCAR_API double trocar_dvh_volume(const double *doses, int64_t count, double dose);

typedef struct trocar_dvh_summary {
    double volume_cm3;           /* cm^3 */
    double mean, least, most;    /* Gy */
    double d10, d30, d80, d90;   /* Gy */
    double v100, v150, v200;     /* fractions of the volume */
    double v100_cm3;             /* cm^3 */
} trocar_dvh_summary;

/* The customary figures: voxel_volume in m^3, prescription in Gy. RT */
TROCAR_API trocar_dvh_summary trocar_dvh_summarise(const double *doses, int64_t count, double voxel_volume, double prescription);

#ifdef __cplusplus
}
#endif
#endif
