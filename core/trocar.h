/* trocar: a flexible needle in soft tissue, for haptic servers, planners and batches.

   A scene describes what to simulate. A model is built from it once, is constant, and is shared by any number of simulations in any number of
   threads. A simulation is everything that changes: a few MB, used by one thread at a time.

       trocar_scene *scene;  trocar_model *model;  trocar_sim *sim;  trocar_error why;  trocar_output out;
       trocar_scene_load("scene.yaml", &scene, &why);
       trocar_model_create(scene, NULL, &model, &why);
       trocar_sim_create(model, &sim, &why);
       trocar_sim_reset(sim, 0, &base, &why);
       trocar_sim_step(sim, 0, &base, 0.001, &out, &why);        out.force is what the hand feels

   Units are SI: m, N, N m, Pa, s, rad. The world frame is the mesh's; quaternions are w, x, y, z and of unit length; the
   needle's axis is its local +z from base to tip, its bevel faces local +y.

   Text: numbers are written and read with a decimal point in any locale; the host's locale is not changed.

   Errors: functions that can fail return a status and leave one message in `error`, with the place and the remedy; `error` may
   be NULL. No function prints, exits or changes signals. Each function says what it allocates; functions marked RT neither allocate, lock, call the
   system nor wait, and may run in a real-time thread.

   Floating point: calls compute with denormals flushed to zero, and restore the caller's mode. The first model sets OpenBLAS to one thread for the
   whole process: its threads would compete with yours, and results would depend on their number. One binary gives the same bits in every run on one
   kind of processor; between kinds, for which OpenBLAS has different kernels, results differ by 1e-12 of their peak. */
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

/* TROCAR_NUMBER of the loaded library; compare it with the header's. While the major version is 0, the minor one changes with the binary interface.
   RT */
TROCAR_API int trocar_version(void);

/* ---- errors ----------------------------------------------------------------------------------------------------------- */

typedef enum trocar_status {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, argument or file is wrong; programs exit with status 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a solve broke down */
    TROCAR_SYSTEM,     /* the operating system refused something */
    TROCAR_NO_REALTIME, /* of programs: the limits do not permit real time; they exit with status 4 */
    TROCAR_CANCELLED   /* the host asked to end a long call: trocar_watch */
} trocar_status;

typedef struct trocar_error {
    char text[1024];
} trocar_error;

/* Callbacks of a long call, in the thread of that call. Both may be NULL. */
typedef struct trocar_watch {
    void (*progress)(const char *what, double fraction, void *context); /* 0 to 1 */
    int (*cancelled)(void *context);   /* returns not 0 to end the call soon, with CANCELLED */
    void *context;
} trocar_watch;

/* ---- values ------------------------------------------------------------------------------------------------------------- */

typedef struct trocar_pose {
    double position[3];      /* m */
    double orientation[4];   /* w x y z, unit: rotates from the needle's frame to the world */
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
enum { TROCAR_MAX_POINTS = 2 * TROCAR_MAX_GUIDES + TROCAR_MAX_CONTACTS + 1 }; /* active contacts of all kinds */

/* One tick's result. */
typedef struct trocar_output {
    double force[3];         /* N, world frame: exerted by the needle's base on the hand */
    double torque[3];        /* N m, world frame, about the base point */
    double depth;            /* m, length of the needle's track in the tissue */
    int32_t contacts;        /* active contacts along the shaft, without the tip */
    uint32_t events;         /* TROCAR_EVENT_ bits */
    int32_t membrane;        /* index in the scene of the membrane punctured in this tick, -1 if none */
    int32_t passes;          /* Newton passes */
    int32_t switches;        /* contacts that changed between sticking and sliding during the solve */
    int32_t reserved;        /* 0 */
} trocar_output;

typedef enum trocar_contact_kind {
    TROCAR_CONTACT_TISSUE = 0,
    TROCAR_CONTACT_TIP = 1,
    TROCAR_CONTACT_GUIDE = 2 /* the edge of a guide's hole, on one of its faces */
} trocar_contact_kind;

/* State of a contact. A tissue contact is planned, then adding, then sticking or sliding until it is removed. */
typedef enum trocar_contact_status {
    TROCAR_CONTACT_PLANNED = 0,  /* ahead of the tip */
    TROCAR_CONTACT_ADDING = 1,   /* the tip has passed, but the worker has not answered yet. Planned and adding contacts bear no force */
    TROCAR_CONTACT_STICKING = 2,
    TROCAR_CONTACT_SLIDING = 3,  /* trocar_contact.state: which way */
    TROCAR_CONTACT_DETACHED = 4  /* no longer used: a buckling needle stays in contact */
} trocar_contact_status;

/* A point where the needle meets the tissue or a guide. */
typedef struct trocar_contact {
    int32_t kind;            /* trocar_contact_kind; more kinds may be added */
    int32_t state;           /* 0 sticks, 1 slides forward, -1 slides backward */
    double arc;              /* m from the base, where the force acts; for the tip, at the needle's end or behind it */
    double depth;            /* m along the track from the skin; 0 for a guide */
    double position[3];      /* m, on the deformed needle, world frame */
    double force[3];         /* N, on the tissue or guide, world frame */
    uint64_t id;             /* of a tissue contact: constant from its addition to its removal, and never reused for this needle; 0 for others */
    int32_t status;          /* trocar_contact_status */
    int32_t slot;            /* tissue contact: 0 to TROCAR_MAX_CONTACTS - 1, constant like the id, but reused later; guide: its index; tip: -1 */
} trocar_contact;

/* A point of a track: where a needle has cut since its last reset. Tissue stays cut, and any needle meets less resistance there. */
typedef struct trocar_track_point {
    double position[3];      /* m, in the tissue at rest */
    int32_t tet;             /* tetrahedron of the model's mesh that contains it */
    int32_t track;           /* from 0, oldest first; the points of a track are ordered from skin to tip, at most 4 mm apart */
    int32_t membrane;        /* index in the scene of the membrane punctured there, -1: none */
    int32_t reserved;        /* 0 */
} trocar_track_point;
enum { TROCAR_MAX_TRACKS = 128, TROCAR_MAX_TRACK_POINTS = 1024 }; /* per needle: 4 m */

/* ---- scene ---------------------------------------------------------------------------------------------------------------- */

/* The contents of a scene file; the docs list its keys. Created by calls or from a file. Not thread-safe. */
typedef struct trocar_scene trocar_scene;

/* Creates an empty scene: every key has its default; set mesh, regions and fixed. Allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_scene_create(trocar_scene **scene, trocar_error *error);

/* Reads a YAML file. Allocates. BAD_INPUT with file, line and key. */
TROCAR_API trocar_status trocar_scene_load(const char *path, trocar_scene **scene, trocar_error *error);
TROCAR_API void trocar_scene_free(trocar_scene *scene); /* NULL is allowed, as in all *_free */

/* Creates an independent copy, including a mesh in memory. Allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_scene_copy(const trocar_scene *scene, trocar_scene **copy, trocar_error *error);

/* Sets a key to a value written as in YAML: ("needle.length", "0.15"), ("fixed", "[back, below]"). A list entry is named by index or name,
   "regions[0].poisson_ratio" or "regions[prostate].friction.static"; an unknown name appends an entry. Paths are relative to the scene file, or to
   the working directory if there is none. BAD_INPUT leaves the scene unchanged. */
TROCAR_API trocar_status trocar_scene_set(trocar_scene *scene, const char *key, const char *value, trocar_error *error);
TROCAR_API trocar_status trocar_scene_set_number(trocar_scene *scene, const char *key, double value, trocar_error *error);

/* Writes the value of a key as in YAML, ended by 0. BAD_INPUT if there is no such key or entry, or if `size` is too small. */
TROCAR_API trocar_status trocar_scene_get(const trocar_scene *scene, const char *key, char *value, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_scene_get_number(const trocar_scene *scene, const char *key, double *value, trocar_error *error);

/* The path from which the scene was loaded, as given; "" if it was not loaded. Valid as long as the scene. */
TROCAR_API const char *trocar_scene_path(const trocar_scene *scene);

/* Limits of the haptic device: the scene's keys "device.", for hosts that enforce them. */
typedef struct trocar_device_limits {
    double max_stiffness;    /* N/m, of the virtual coupling; INFINITY: no coupling, the needle follows rigidly */
    double max_force;        /* N */
    double max_torque;       /* N m */
    double max_force_rate;   /* N/s */
    double max_torque_rate;  /* N m/s */
    double max_speed;        /* m/s, of the base point */
    double max_turn_rate;    /* rad/s */
    double hold_time;        /* s without a pose before the wrench is ramped down */
    double ramp_time;        /* s from the full wrench to none, and back */
    double mass;             /* kg, of device and hand at the handle; the virtual coupling allows for half of it */
    double delay;            /* s, round trip between bridge and device: from a force until positions show its effect */
} trocar_device_limits;
TROCAR_API trocar_device_limits trocar_scene_device(const trocar_scene *scene);

/* The pose of the first needle's base before the insertion: the keys "needle.start.". Returns 1 and the pose, or 0 if there is none. */
TROCAR_API int trocar_scene_start(const trocar_scene *scene, trocar_pose *start);

/* Transform from the patient's coordinates to the mesh's, as trocar_model_patient_to_mesh. Returns 1 and the matrix, or 0 if the scene has none. */
TROCAR_API int trocar_scene_patient_to_mesh(const trocar_scene *scene, double matrix[16]);

/* Limits of the key "rate_hz", Hz. */
#define TROCAR_MIN_RATE 250.0
#define TROCAR_MAX_RATE 10000.0

/* Number of entries of "regions", "membranes", "guides", "fixed" or "relaxation"; -1 for another key. */
TROCAR_API int trocar_scene_count(const trocar_scene *scene, const char *list);

/* A tetrahedral mesh in memory. Tetrahedra may have either orientation. */
typedef struct trocar_mesh {
    int32_t node_count, tet_count;
    const double *nodes;             /* 3 node_count, m */
    const int32_t *tets;             /* 4 tet_count, node indices from 0 */
    const int32_t *tet_region;       /* tet_count: index into `regions`; NULL: all are in region 0 */
    int32_t region_count;
    const char *const *regions;      /* names */
    int32_t triangle_count;          /* triangles of named surfaces: faces of tetrahedra */
    const int32_t *triangles;        /* 3 triangle_count */
    const int32_t *triangle_surface; /* triangle_count: index into `surfaces` */
    int32_t surface_count;
    const char *const *surfaces;     /* names: for membranes and `fixed` */
} trocar_mesh;

/* Takes the mesh from arrays instead of a file; copies them. BAD_INPUT for indices out of range and the like; trocar_model_create checks whether the
   mesh is valid. */
TROCAR_API trocar_status trocar_scene_set_mesh(trocar_scene *scene, const trocar_mesh *mesh, trocar_error *error);

/* How a key's value is written. */
typedef enum trocar_key_kind {
    TROCAR_KEY_NUMBER = 0,
    TROCAR_KEY_TEXT = 1,     /* a word, name or path */
    TROCAR_KEY_NUMBERS = 2,  /* a list of numbers */
    TROCAR_KEY_NAMES = 3     /* a list of names */
} trocar_key_kind;

/* One row of the reference table of keys. The strings live as long as the program. */
typedef struct trocar_key {
    const char *key;         /* "regions[].friction.static": one for each list entry */
    const char *unit;        /* "" if there is none */
    const char *accepts;     /* "a number above 0" */
    const char *standard;    /* default, "" if there is none */
    const char *doc;
    int required;
    int32_t kind;            /* trocar_key_kind */
} trocar_key;
TROCAR_API int trocar_key_count(void);
TROCAR_API trocar_key trocar_key_at(int index); /* all members are empty if `index` is out of range */

/* ---- model -------------------------------------------------------------------------------------------------------------------- */

/* Mesh, stiffness, inverse, needle and materials: constant, and shared by threads without a lock. Only calls to a sparse inverse, and to nodes
   outside a condensed inverse's region, are serialised. */
typedef struct trocar_model trocar_model;

typedef struct trocar_model_options {
    void (*progress)(const char *what, double fraction, void *context); /* 0..1, during a long start; may be NULL. Must not wait for another model to
                                                                           be created */
    void *context;
    int longest_catch_up;    /* steps of at most 1 ms into which a long tick is divided; 0: the default, 4 */
    int mesh_only;           /* 1: only reads and checks the mesh and the names in it, for viewers. Such a model has no stiffness, and no simulation
                                can be created from it */
    int keep_inverse;        /* 1: fail (SYSTEM), before a condensed inverse is computed, if it cannot be saved in the cache */
    int (*cancelled)(void *context); /* called in the same thread; not 0 ends the call soon, with CANCELLED. Reading a mesh and factorising are not
                                        interrupted: seconds at 20 000 nodes. May be NULL */
} trocar_model_options;

/* Builds everything; `options` may be NULL. Takes seconds for thousands of nodes, and minutes for tens of thousands unless the condensed inverse is
   cached. Above 30 000 unknowns, condensing uses as many threads as BLAS does by default. While a dense or sparse inverse is computed, BLAS has that
   many threads in the whole process, and one afterwards: simulations and models beside it may be slower and differ in their last bits, and a second
   inverse of this kind waits. Allocates 8 (3 n)^2 bytes for a dense inverse of n nodes. Loads Gmsh to read a mesh file that is not MSH 2.2 or 4.1; then,
   inside a host that uses Gmsh itself, the host's session is preserved, but call it from one thread, and since Gmsh sets the process's locale for a
   moment when it starts, other threads should not format numbers. The scene is not needed afterwards. BAD_INPUT, NO_MEMORY, NUMERIC, SYSTEM, CANCELLED. */
TROCAR_API trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model,
                                             trocar_error *error);
TROCAR_API void trocar_model_free(trocar_model *model); /* its memory is released with the last simulation, picture or derived model that uses it */

/* Creates a model of another scene that shares the mesh, stiffness and inverse of `base`: takes milliseconds and little memory. The scenes may differ
   in needle, friction, cutting, puncture forces, stiffening, relaxation, guides, contacts and seeds. BAD_INPUT, with the key, if mesh, stiffness or
   inverse would differ, and for meshes from arrays; NO_MEMORY. */
TROCAR_API trocar_status trocar_model_derive(const trocar_model *base, const trocar_scene *scene, trocar_model **model, trocar_error *error);

/* All strings and arrays belong to the model. */
TROCAR_API const char *trocar_model_inverse(const trocar_model *model);        /* "dense", "sparse" or "condensed"; "" with mesh_only */
TROCAR_API const char *trocar_model_description(const trocar_model *model);    /* which inverse was chosen, and why */
TROCAR_API const char *trocar_model_remarks(const trocar_model *model);        /* repairs of the mesh, and suspected errors in it; "": none */
TROCAR_API int trocar_model_unknowns(const trocar_model *model);               /* three per free node */
TROCAR_API int trocar_model_needles(const trocar_model *model);                /* number of needles of the scene */
TROCAR_API int trocar_model_segments(const trocar_model *model);               /* of the needle, which has one joint more */
TROCAR_API double trocar_model_needle_length(const trocar_model *model);       /* m */
TROCAR_API double trocar_model_rate(const trocar_model *model);                /* Hz, rate_hz of the scene */

/* The pose of the first needle's base before the insertion: the scene's keys "needle.start.". Returns 1 and the pose, or 0 if there is none. */
TROCAR_API int trocar_model_start(const trocar_model *model, trocar_pose *start);

/* Transform from the patient's coordinates (DICOM: mm to the left, back and head) to the mesh's (m): the scene's key "patient_to_mesh", row by row;
   its upper left 3 x 3 is a rotation times 1e-3. Returns 1 and the matrix, or 0 if the scene has none. */
TROCAR_API int trocar_model_patient_to_mesh(const trocar_model *model, double matrix[16]);

/* The mesh at rest. Its named groups, called regions here, have a dimension: 3 for volumes, 2 for surfaces, 1 and 0 for curves and points. */
TROCAR_API int trocar_model_node_count(const trocar_model *model);
TROCAR_API int trocar_model_tet_count(const trocar_model *model);
TROCAR_API const double *trocar_model_nodes(const trocar_model *model);        /* 3 node_count, m */
TROCAR_API const int32_t *trocar_model_tets(const trocar_model *model);        /* 4 tet_count, positive volume */
TROCAR_API const int32_t *trocar_model_neighbours(const trocar_model *model);  /* 4 tet_count: tetrahedron across the face opposite each corner, -1: none */
TROCAR_API const int32_t *trocar_model_tet_regions(const trocar_model *model); /* tet_count: index of the volume */
TROCAR_API const uint32_t *trocar_model_face_surfaces(const trocar_model *model); /* 4 tet_count: bit i is set if the face lies on region i, a surface
                                                                                     */
TROCAR_API const uint8_t *trocar_model_fixed(const trocar_model *model);       /* node_count: 1 for nodes held at zero displacement; NULL with
                                                                                  mesh_only */
TROCAR_API int trocar_model_region_count(const trocar_model *model);           /* of any dimension, at most 32 */
TROCAR_API const char *trocar_model_region_name(const trocar_model *model, int index); /* "" if out of range */
TROCAR_API int trocar_model_region_dimension(const trocar_model *model, int index);    /* -1 if out of range */
TROCAR_API int trocar_model_find_region(const trocar_model *model, const char *name, int dimension); /* index, or -1 */

/* Finds where the segment between two points (m) first enters the tissue at rest. Returns 1 and the point, or 0 if it never does. RT */
TROCAR_API int trocar_model_entry(const trocar_model *model, const double from[3], const double to[3], double point[3]);

/* Material of a volume: the scene's keys "regions[]." of the same name. All zero if it is not a volume. */
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

/* A guide of the scene, the key "guides[]". Hole (column, row), counted from 0, has its axis at origin + (column - (columns - 1) / 2) spacing
   across[0] + (row - (rows - 1) / 2) spacing across[1] on the front face. */
typedef struct trocar_guide {
    double origin[3];        /* m, middle of the holes on the front face */
    double normal[3];        /* unit vectors: through the plate, */
    double across[2][3];     /* along columns, and along rows, perpendicular to each other; with the normal, right- or left-handed */
    double spacing;          /* m */
    double hole_diameter;    /* m */
    double thickness;        /* m */
    int32_t columns, rows;
} trocar_guide;
TROCAR_API int trocar_model_guide_count(const trocar_model *model);
TROCAR_API trocar_guide trocar_model_guide(const trocar_model *model, int index); /* all zero if out of range */

/* The scene's ultrasound probe, the keys "probe.": a cylinder along its local +z, from its base, where the hand holds it, to its tip at z = length.
   Returns 1 and the probe, or 0 when the scene has none. */
typedef struct trocar_probe_shape {
    double radius;           /* m */
    double tip_radius;       /* m, of the rounded edge at its end */
    double length;           /* m, from base to tip */
    int32_t surface;         /* index of the region, a surface, that the probe presses */
    int32_t reserved;        /* 0 */
} trocar_probe_shape;
TROCAR_API int trocar_model_probe(const trocar_model *model, trocar_probe_shape *shape);

/* The initial pose of the probe's base: the keys "probe.start.". Returns 1 and the pose, or 0 if the scene has none. */
TROCAR_API int trocar_model_probe_start(const trocar_model *model, trocar_pose *start);

/* How volumetric strains are averaged (key "volumetric_strain"): 1 around nodes, else 0. */
TROCAR_API int trocar_model_averages_strain(const trocar_model *model);

/* If they are averaged over patches of tetrahedra: tet_count patch numbers from 0; else, and with mesh_only, NULL. */
TROCAR_API const int32_t *trocar_model_strain_patches(const trocar_model *model);

/* Computes now what would otherwise be computed on first use: the factor for contacts outside a condensed inverse's region, which takes a minute and
   gigabytes on a large mesh. May be called from any thread, concurrently with the others. Allocates. */
TROCAR_API trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error);

/* ---- simulation ------------------------------------------------------------------------------------------------------------------ */

/* The needles and their effect on the tissue. `needle` is an index: 0 to trocar_model_needles() - 1.

   One thread ticks several needles one after another, each with its own pose. Each feels the displacement of the tissue by the others, as of its last
   answer from the worker: one step late in lockstep, as late as the worker in real time; changes of a force below 1 mN are ignored. All follow the
   tracks that any of them has cut. Needles do not touch each other, and needles in the same element of the mesh do not share its contact nodes.

   A needle that is left rests: its base is free, and tissue and guides hold it. Tick cost is independent of the number of resting needles. Resting
   needles respond to other loads linearly about the equilibrium in which they were left, and slip where friction is exceeded, at 250 Hz (100 Hz while
   a probe presses). */
typedef struct trocar_sim trocar_sim;

/* Every needle is straight, with its base at the origin, until it is reset. Allocates everything that the simulation will need except the scratch
   memory of displacements. NO_MEMORY. */
TROCAR_API trocar_status trocar_sim_create(trocar_model *model, trocar_sim **sim, trocar_error *error);
TROCAR_API void trocar_sim_free(trocar_sim *sim);

/* Makes the needle straight at `base`, and the tissue as if it had never been there: removes its tracks, and its forces from the memory of relaxing
   tissue. Effects of other needles stay, and so do seeds, including those still in the needle. If it lies in the tissue, it counts as inserted along
   its axis, without force. Resetting a resting needle removes it from the tissue. BAD_INPUT if `needle` is out of range, or the pose is not finite or
   not of unit length (1e-3). RT, except for one write() to an eventfd. */
TROCAR_API trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error);

/* Lockstep, for planners and batches: a tick of `dt` seconds (above 0, at most 1), followed by the mesh update that it requested, so that the next
   tick has it. Deterministic. Pending leave and take requests complete first. BAD_INPUT as in reset, and for a resting needle; NUMERIC if the mesh
   update fails. If the result is not finite, the insertion restarts as in trocar_sim_tick, and the status is OK. */
TROCAR_API trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output,
                                         trocar_error *error);

/* Real time: the same tick with the worker's newest answer. BAD_INPUT, without effect, as in reset, and for a needle that rests or that the worker
   has not handed over yet. NUMERIC if the result was not finite: the insertion has been reset at `base`, and the output is zero except
   TROCAR_EVENT_UNSTABLE. RT, except for one write() to an eventfd if there is a new request to the worker. */
TROCAR_API trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);

/* Leaves a needle: its base moves until no force is left on it (1 mN), and there it rests. The worker does that, or in lockstep the next
   trocar_sim_step (of any needle) or trocar_sim_work; until then the needle is LEAVING. Other held needles feel the release spread over 0.1 s of
   their ticks. If the needle finds no equilibrium, that call fails, and the needle is HELD as before. Around a resting needle, relaxation pauses
   until the needle is taken. BAD_INPUT if the needle is out of range, is not in the tissue, is moving to another equilibrium or rests already, or
   with a remeshing method other than nested and implicit. RT, except for one write() to an eventfd, and a copy of 150 kB. */
TROCAR_API trocar_status trocar_sim_leave(trocar_sim *sim, int needle, trocar_error *error);

/* Takes a resting needle: it is TAKING until the worker, or in lockstep the next step, has handed it over. The first tick's pose should be
   trocar_sim_base(), the base's current pose. BAD_INPUT if the needle is out of range or does not rest. RT, except for one write() to an eventfd. */
TROCAR_API trocar_status trocar_sim_take(trocar_sim *sim, int needle, trocar_error *error);

typedef enum trocar_needle_state {
    TROCAR_NEEDLE_HELD,      /* driven by the caller; also outside the tissue */
    TROCAR_NEEDLE_LEAVING,
    TROCAR_NEEDLE_RESTING,
    TROCAR_NEEDLE_TAKING
} trocar_needle_state;

/* HELD if the needle is out of range. Ticking thread. RT */
TROCAR_API trocar_needle_state trocar_sim_needle_state(const trocar_sim *sim, int needle);

/* Holds the base by a spring of this compliance, m/N, whose other end is at the pose given to each tick; 0, the default: rigidly. Persists until set
   again. For a host with a virtual coupling: because it is solved together with the needle, the spring may be arbitrarily stiff. RT */
TROCAR_API void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance);

/* The base's pose: the last pose given, moved by the spring's deflection; for a resting needle, its current pose. RT */
TROCAR_API trocar_pose trocar_sim_base(const trocar_sim *sim, int needle);

/* Moves the probe. It presses its surface without friction and never pulls; needles feel how it displaces and holds the tissue. It stops where the
   force would exceed the scene's probe.max_force, and continues once a pose leads it back. The worker solves for it, at least 50 times a second if
   called as often; in lockstep the next trocar_sim_step does, before its tick. Only the newest pose counts. Needles' effect on the probe is updated
   at 100 Hz, as for resting needles. BAD_INPUT, and the probe stays where it was, for a pose as in reset and if the scene has no probe. RT, except
   for one write() to an eventfd. */
TROCAR_API trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error);

/* The probe as last solved. */
typedef struct trocar_probe {
    trocar_pose base;
    double force[3];         /* N, world frame: exerted by the probe on the hand */
    double torque[3];        /* N m, world frame, about the base point */
    int32_t contacts;        /* points of the surface that it presses, nodes and middles of edges; at most TROCAR_MAX_PRESSED */
    int32_t placed;          /* 0: the scene has no probe, or no acceptable pose has been given yet; everything except `stopped` is 0 then */
    int32_t stopped;         /* 1: the tissue keeps it from the last pose given, and it stays at `base`: its force would exceed the scene's
                                probe.max_force, or it jumped and its axis would lie in the tissue */
    int32_t reserved;        /* 0 */
} trocar_probe;
enum { TROCAR_MAX_PRESSED = 256 };

/* Ticking thread. RT */
TROCAR_API trocar_probe trocar_sim_probe(const trocar_sim *sim);

/* Result of a call of trocar_sim_work. */
typedef struct trocar_work {
    int32_t answered;        /* 1: it answered a request; 0: there was none */
    int32_t more;            /* 1: more work is pending */
    int32_t kept;            /* 1: a needle that should be left finds no equilibrium without the hand (NUMERIC), or slips out of the tissue
                                (BAD_INPUT): it is held as before */
    int64_t latency;         /* ns from that request to its answer, by the simulation's clock; 0 without a clock */
} trocar_work;

/* The worker's part, from one thread beside the ticking one: serves the newest request if there is one, else prepares nodes ahead along the needle's
   line. `work` may be NULL. May take long. Allocates when a needle is left or taken, and when the probe presses other nodes; otherwise only what a
   sparse inverse caches. On an error (NO_MEMORY, NUMERIC) the last answer stays in use. */
TROCAR_API trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *work, trocar_error *error);

/* ns since the oldest request that has not been answered yet, by the simulation's clock; 0 if all are answered. Ticking thread. RT */
TROCAR_API int64_t trocar_sim_waiting(const trocar_sim *sim);

/* A descriptor for poll(): readable when a request waits. It belongs to the simulation. */
TROCAR_API int trocar_sim_work_descriptor(const trocar_sim *sim);

/* Saves everything that changes, as a block of `trocar_sim_state_size` bytes in the caller's memory, valid for any simulation of the same model in
   this process. Between lockstep steps only. After a restore, results are those that followed the save: to the bit with `remeshing: nested` on a
   dense or condensed inverse without resting needles, else to rounding. Without resting needles, restore allocates nothing. BAD_INPUT for a wrong
   size or another model's state. */
TROCAR_API size_t trocar_sim_state_size(const trocar_sim *sim);
TROCAR_API trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error);

/* Active contacts with the tissue and with guides, from base to tip, the tip last if it is in the tissue. Fills at most `room` and returns how many
   there are, at most TROCAR_MAX_POINTS. RT */
TROCAR_API int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room);

/* Tissue contacts that are not active yet, from base to tip: ADDING, or PLANNED (at most one, the last). The position of a planned one is its place
   in the tissue at rest, and its arc the needle's length. Like trocar_sim_contacts. RT */
TROCAR_API int trocar_sim_pending_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room);

/* The hole of a guide that the needle is in: column + columns * row, from 0. TROCAR_NO_HOLE: not at the guide, or beside its plate;
   TROCAR_MISSED_HOLE: through the plate beside its holes (TROCAR_EVENT_MISSED_GUIDE). RT */
enum { TROCAR_NO_HOLE = -1, TROCAR_MISSED_HOLE = -2 };
TROCAR_API int trocar_sim_hole(const trocar_sim *sim, int needle, int guide);

/* The tracks that this needle has cut since its last reset. Fills at most `room` points and returns how many there are, at most
   TROCAR_MAX_TRACK_POINTS. RT */
TROCAR_API int trocar_sim_tracks(const trocar_sim *sim, int needle, trocar_track_point *points, int room);

/* Joints of the needle from base to tip, 3 numbers each, m. Fills at most `room` joints and returns how many there are. RT */
TROCAR_API int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room);

/* Rotation of the tip about the needle's axis minus that of the base, rad: friction in the tissue twists the needle, so the tip of a needle that is
   turned forward lags, which is negative. RT */
TROCAR_API double trocar_sim_tip_lead(const trocar_sim *sim, int needle);

/* Elastic energy of the bent needle, J. RT */
TROCAR_API double trocar_sim_needle_energy(const trocar_sim *sim, int needle);

/* Displacement of the mesh's nodes, 3 node_count, m. One solve with the whole matrix: milliseconds to tenths of a second. The
   first call allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_sim_displacements(trocar_sim *sim, double *displacements, trocar_error *error);

/* ---- seeds --------------------------------------------------------------------------------------------------------------------------- */

/* A brachytherapy seed: a material point of the tissue with a direction. It moves with the tissue, and stays when needles are reset or withdrawn. It
   is a marker: it neither stiffens the tissue nor is dragged along by the needle. */
typedef struct trocar_seed {
    double position[3];      /* m, its centre in the tissue at rest */
    double direction[3];     /* unit vector from its proximal to its distal end, in the tissue at rest */
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
    double spacing;          /* between the centres of neighbouring seeds of a strand */
} trocar_seed_size;
TROCAR_API trocar_seed_size trocar_model_seed_size(const trocar_model *model);

/* Drops a seed, or a strand of `count`, 1 to TROCAR_MAX_STRAND, `spacing` apart from centre to centre (m, at least a seed's length; 0: the scene's).
   The tip is now at the distal end of the first seed. The mandrin holds the seeds there while the needle is drawn back: each stays in the tissue, on
   the needle's track, once the tip has passed its proximal end. BAD_INPUT, without effect, if the needle is out of range, the count or spacing is
   wrong, the tip is outside the tissue or not deep enough for the whole strand, seeds of this needle are pending, there would be more than
   TROCAR_MAX_SEEDS, or the scene's seeds are thicker than its needle. Between ticks, from the ticking thread. RT */
TROCAR_API trocar_status trocar_sim_drop_seeds(trocar_sim *sim, int needle, int count, double spacing, trocar_error *error);

/* Takes back the pending seeds of the needle's last drop; if there are none, removes the seed that this needle left last. BAD_INPUT if there is
   none, and if the needle is out of range. Between ticks, from the ticking thread. RT */
TROCAR_API trocar_status trocar_sim_undo_seed(trocar_sim *sim, int needle, trocar_error *error);

/* The seeds in the tissue, in the order in which they were left. Fills at most `room` and returns how many there are, at most
   TROCAR_MAX_SEEDS. RT */
TROCAR_API int trocar_sim_seeds(const trocar_sim *sim, trocar_seed *seeds, int room);

/* Seeds that were dropped but are still in the needle. RT */
TROCAR_API int trocar_sim_pending_seeds(const trocar_sim *sim, int needle);

/* A seed in the displaced tissue: its centre (m), and its direction turned with the surrounding tissue. `displacements`: as from
   trocar_sim_displacements or trocar_picture_displacements. Returns 1, or 0 if the seed is in no tetrahedron of the model. RT */
TROCAR_API int trocar_model_displace_seed(const trocar_model *model, const double *displacements, const trocar_seed *seed, double position[3],
                                          double direction[3]);

/* ---- measuring ----------------------------------------------------------------------------------------------------------------------- */

/* Sets the clock of this simulation: monotonic ns, called from the ticking thread and the worker's; NULL, the default: nothing is measured. Set it
   before both start. */
TROCAR_API void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void));

/* ns spent in the stages of the last tick. RT */
enum { TROCAR_STAGE_TISSUE, TROCAR_STAGE_NEEDLE, TROCAR_STAGE_CONTACT, TROCAR_STAGE_WRENCH, TROCAR_STAGES };
TROCAR_API void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[4]);

/* ---- pictures --------------------------------------------------------------------------------------------------------------------- */

/* A copy of what can be shown of a simulation after a tick: needle, contacts, forces. The ticking thread fills it, and may hand it to another thread,
   which then computes displacements at leisure. One thread at a time. */
typedef struct trocar_picture trocar_picture;

/* An empty picture: needle straight at the origin. Allocates, up to 150 kB per needle. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_create(trocar_model *model, trocar_picture **picture, trocar_error *error);
TROCAR_API void trocar_picture_free(trocar_picture *picture);

/* Copies up to 150 kB per needle. Simulation and picture must belong to one model. RT */
TROCAR_API void trocar_sim_take_picture(const trocar_sim *sim, trocar_picture *picture);
TROCAR_API void trocar_picture_copy(const trocar_picture *from, trocar_picture *to);

/* Like trocar_sim_contacts, trocar_sim_tracks, trocar_sim_centreline, trocar_sim_base and trocar_sim_tip_lead. RT */
TROCAR_API int trocar_picture_contacts(const trocar_picture *picture, int needle, trocar_contact *contacts, int room);
TROCAR_API int trocar_picture_tracks(const trocar_picture *picture, int needle, trocar_track_point *points, int room);
TROCAR_API int trocar_picture_centreline(const trocar_picture *picture, int needle, double *joints, int room);
TROCAR_API trocar_pose trocar_picture_base(const trocar_picture *picture, int needle);
TROCAR_API double trocar_picture_tip_lead(const trocar_picture *picture, int needle);

/* Like trocar_sim_seeds and trocar_sim_pending_seeds. RT */
TROCAR_API int trocar_picture_seeds(const trocar_picture *picture, trocar_seed *seeds, int room);
TROCAR_API int trocar_picture_pending_seeds(const trocar_picture *picture, int needle);

/* As trocar_sim_probe. RT */
TROCAR_API trocar_probe trocar_picture_probe(const trocar_picture *picture);

/* Like trocar_sim_displacements: the first call allocates. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_displacements(trocar_picture *picture, double *displacements, trocar_error *error);

/* The refined mesh: nodes of the model's mesh, then the contact nodes. Stiffness times displacements = forces at all free nodes. The arrays belong to
   the picture, and are valid until its next call. */
typedef struct trocar_refined_mesh {
    int32_t node_count, tet_count;
    const double *nodes;         /* 3 node_count, m, at rest */
    const int32_t *tets;         /* 4 tet_count */
    const int32_t *parents;      /* tet_count: the tetrahedron of the model's mesh that contains it */
    const double *displacements; /* 3 node_count, m */
    const double *forces;        /* 3 node_count, N, on the tissue */
    double damping[3];           /* N, part of `forces` that the needle does not feel: it slows tissue that springs back at the tip */
} trocar_refined_mesh;

/* Allocates; costs one call of trocar_picture_displacements. NO_MEMORY. */
TROCAR_API trocar_status trocar_picture_refined_mesh(trocar_picture *picture, trocar_refined_mesh *mesh, trocar_error *error);

/* ---- batches ------------------------------------------------------------------------------------------------------------------------ */

/* Runs `batch` insertions of `steps` ticks of `dt` seconds, each in its own simulation, which is reset at its first pose; poses, of needle 0, and
   outputs are [batch][steps]. Runs `threads` of them at a time, and allocates one simulation per thread. With `remeshing: nested` on a dense or
   condensed inverse the bits do not depend on the number of threads. On an error the outputs of that insertion are zero from there on and the first
   message is returned; the other insertions are finished. */
TROCAR_API trocar_status trocar_rollout(trocar_model *model, const trocar_pose *poses, int batch, int steps, double dt, int threads,
                                        trocar_output *outputs, trocar_error *error);

/* Like trocar_rollout, with a watch, which may be NULL, called every 64 ticks. CANCELLED: outputs of unfinished ticks are zero. */
TROCAR_API trocar_status trocar_rollout_watched(trocar_model *model, const trocar_pose *poses, int batch, int steps, double dt, int threads,
                                                const trocar_watch *watch, trocar_output *outputs, trocar_error *error);

/* Calls trocar_sim_step for each of `steps` poses, with a watch as above. On an error the message names the step, and outputs are zero from there on.
   */
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

/* Loads a seed model by name: "I-125 6711" or "Pd-103 200", consensus data of TG-43U1. Allocates. BAD_INPUT for another name; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_source_create(const char *name, trocar_dose_source **source, trocar_error *error);

/* Loads a seed model from a YAML table; docs/dose.md lists its keys. Allocates. BAD_INPUT with file, line and remedy, also for missing values, for
   radii or angles that do not increase, and for g or F that are not 1 where they are so by definition; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_source_load(const char *path, trocar_dose_source **source, trocar_error *error);
TROCAR_API void trocar_dose_source_free(trocar_dose_source *source); /* call after freeing the doses that use it */

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
    double strength;             /* U, air-kerma strength at the time of implantation, above 0, at most 1000 */
} trocar_dose_seed;

/* Dose rates (Gy/h) of `seed_count` seeds at `count` points [count][3] (m): the sum of the formula in floating point. 25 ns per point and seed.
   BAD_INPUT, and nothing is written, for a seed or point that is not finite or beyond 1000 m, or a bad strength or direction. RT */
TROCAR_API trocar_status trocar_dose_rates(const trocar_dose_source *source, const trocar_dose_seed *seeds, int seed_count, const double *points,
                                           int64_t count, double *rates, trocar_error *error);

/* The dose of a permanent implant at many points, on a grid or elsewhere. One thread at a time. Doses are whole multiples of TROCAR_DOSE_QUANTUM, so
   sums are exact: they do not depend on the order in which seeds are added and removed, and removing a seed leaves every point as if it had never
   been there, to the bit. A seed's contribution is rounded to the nearest multiple, and limited to TROCAR_DOSE_MOST. */
typedef struct trocar_dose trocar_dose;
#define TROCAR_DOSE_QUANTUM 5.8207660913467407e-11 /* Gy: 2^-34 */
#define TROCAR_DOSE_MOST 131072.0                  /* Gy, of one seed at one point: 2^17 */
enum { TROCAR_MAX_DOSE_SEEDS = 4095 };

/* Voxel (i, j, k), counted from 0, has the index (i counts[1] + j) counts[2] + k, and its centre at origin + spacing (i, j, k). */
typedef struct trocar_dose_grid {
    double origin[3];            /* m, centre of voxel (0, 0, 0) */
    double spacing;              /* m, above 0 */
    int32_t counts[3];           /* voxels along x, y and z: at least 1, at most 2^28 in total */
} trocar_dose_grid;

/* Creates a dose of zero. Allocates 8 bytes per voxel of the grid, or 32 per point. The source must outlive it; points [count][3], m, are copied, at
   most 2^28. BAD_INPUT for a bad grid or point; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_create(const trocar_dose_source *source, const trocar_dose_grid *grid, trocar_dose **dose, trocar_error *error);
TROCAR_API trocar_status trocar_dose_create_points(const trocar_dose_source *source, const double *points, int64_t count, trocar_dose **dose,
                                                   trocar_error *error);
TROCAR_API void trocar_dose_free(trocar_dose *dose);

/* Adds a seed; `id` (may be NULL) identifies it, and is never reused. 25 ns per point. Allocates a little for the list of seeds. BAD_INPUT as in
   trocar_dose_rates, and beyond TROCAR_MAX_DOSE_SEEDS seeds; NO_MEMORY. After an error nothing has changed. */
TROCAR_API trocar_status trocar_dose_add(trocar_dose *dose, const trocar_dose_seed *seed, int32_t *id, trocar_error *error);

/* Removes a seed, or changes its place, direction and strength: takes as long as one addition, or two. BAD_INPUT, without effect, for an unknown id
   or a bad seed. RT */
TROCAR_API trocar_status trocar_dose_remove(trocar_dose *dose, int32_t id, trocar_error *error);
TROCAR_API trocar_status trocar_dose_move(trocar_dose *dose, int32_t id, const trocar_dose_seed *seed, trocar_error *error);

/* Moves every point to its place at rest plus its displacement [count][3], m; NULL: back to rest. Seeds do not move: for deformed anatomy move them
   too. Recomputes all seeds. Allocates 24 bytes per point the first time. BAD_INPUT, without effect, for a displacement that is not finite or a point
   beyond 1000 m; NO_MEMORY. */
TROCAR_API trocar_status trocar_dose_displace(trocar_dose *dose, const double *displacements, trocar_error *error);

TROCAR_API int64_t trocar_dose_point_count(const trocar_dose *dose);   /* RT */
TROCAR_API int trocar_dose_seed_count(const trocar_dose *dose);        /* RT */
TROCAR_API void trocar_dose_values(const trocar_dose *dose, double *values); /* Gy, of all points. RT */

/* The voxels whose centres, multiples of the spacing plus one half, are inside an organ at rest. Constant. */
typedef struct trocar_structure trocar_structure;

/* Voxels inside a closed surface: the triangles whose triangle_surface is `surface`, or all if that is NULL. Every edge must belong to an even number
   of triangles; their orientation does not matter. Uses nodes and triangles of `mesh`. `spacing` in m, above 0. Allocates, temporarily 1 byte per
   voxel of the surface's box. BAD_INPUT for an open surface (names an edge), one without triangles or voxels, an index out of range, and more than
   2^28 voxels in the box; NO_MEMORY. */
TROCAR_API trocar_status trocar_structure_from_surface(const trocar_mesh *mesh, int surface, double spacing, trocar_structure **structure,
                                                       trocar_error *error);

/* Voxels inside the tetrahedra whose tet_region is `region`, or all if that is NULL. Uses nodes and tetrahedra of `mesh`, as trocar_model_nodes,
   trocar_model_tets and trocar_model_tet_regions return them. Allocates, temporarily 4 bytes per voxel of the region's box. Errors as above. */
TROCAR_API trocar_status trocar_structure_from_region(const trocar_mesh *mesh, int region, double spacing, trocar_structure **structure,
                                                      trocar_error *error);
TROCAR_API void trocar_structure_free(trocar_structure *structure);
TROCAR_API int64_t trocar_structure_count(const trocar_structure *structure);         /* voxels, at least 1. RT */
TROCAR_API const double *trocar_structure_points(const trocar_structure *structure);  /* [count][3], m, their centres; belongs to the structure. RT */
TROCAR_API double trocar_structure_voxel(const trocar_structure *structure);          /* m^3, volume of a voxel. RT */

/* Displacements [count][3] of the voxels' centres, interpolated from those of the mesh's nodes, [node_count][3] (m), as returned by
   trocar_sim_displacements; for trocar_dose_displace. BAD_INPUT for a structure made from a surface. RT */
TROCAR_API trocar_status trocar_structure_displacements(const trocar_structure *structure, const double *nodal, double *displacements,
                                                        trocar_error *error);

/* Cumulative dose-volume histogram of voxels of equal size. First sorts the doses in place, largest first; BAD_INPUT if one is not finite or there is
   none. The other functions take sorted doses, `count` at least 1. */
TROCAR_API trocar_status trocar_dvh_sort(double *doses, int64_t count, trocar_error *error);

/* The dose (Gy) that the fraction 0 to 1 of the volume receives at least, with linear interpolation between voxels: 0.9 for D90. RT */
TROCAR_API double trocar_dvh_dose(const double *doses, int64_t count, double fraction);

/* The fraction of the volume that receives `dose` (Gy) or more: the prescription for V100, 1.5 times that for V150. RT */
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
