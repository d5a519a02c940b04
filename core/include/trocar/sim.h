/* Simulations: needles and their effect on the tissue, ticks, and the worker. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SIM_H
#define TROCAR_PUBLIC_SIM_H

#include "trocar/model.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A scene's needles and their effect on the tissue. The argument `needle` is always an index, counted from 0. */
typedef struct trocar_sim trocar_sim;

enum { TROCAR_MAX_NEEDLES = 32, TROCAR_MAX_GUIDES = 8 };

/* ---- creation ---- */

/* Creates a simulation. Until it is reset, each needle is straight with its base at the origin. NO_MEMORY; BAD_INPUT for a model with mesh_only.
   [any, allocates] */
TROCAR_API trocar_status trocar_sim_create(trocar_model *model, trocar_sim **sim, trocar_error *error);
TROCAR_API void trocar_sim_free(trocar_sim *sim); /* [alone] */

/* Straightens the needle, places its base at `base`, and restores the tissue as if this needle had never touched it; seeds and other needles stay. A needle
   that overlaps the tissue counts as having been inserted along its axis without force. BAD_INPUT if `needle` is out of range, or if the pose is not finite
   or its quaternion's length is not within 1e-3 of 1. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error);

/* ---- ticks ---- */

/* Events during a tick: bits of trocar_output.events. */
enum {
    TROCAR_EVENT_TOUCHED = 1 << 0,    /* the tip touched the outer surface */
    TROCAR_EVENT_PUNCTURED = 1 << 1,  /* a membrane was punctured; trocar_output.membrane is its index */
    TROCAR_EVENT_ADDED = 1 << 2,      /* a contact became active */
    TROCAR_EVENT_REMOVED = 1 << 3,    /* a contact was removed because the tip returned to it */
    TROCAR_EVENT_EXITED = 1 << 4,     /* the tip left the tissue on the far side */
    TROCAR_EVENT_REENTERED = 1 << 5,  /* the tip returned to the tissue the way it had left */
    TROCAR_EVENT_WITHDRAWN = 1 << 6,  /* the needle was withdrawn from the tissue through its entry */
    TROCAR_EVENT_LATE = 1 << 7,       /* the worker's answer for the tissue at the tip was not ready, so the tick used the last answer, or an estimate */
    TROCAR_EVENT_FULL = 1 << 8,       /* no more contacts can be added (TROCAR_MAX_CONTACTS), or the track has more than 256 layers */
    TROCAR_EVENT_UNSTABLE = 1 << 9,   /* the result was not finite, so the insertion was restarted */
    TROCAR_EVENT_KEPT = 1 << 10,      /* no longer set */
    TROCAR_EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes through a guide's plate outside its holes, so it is not guided; set in every such tick */
    TROCAR_EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft pushes into a body sideways, which the model gives no force for; set in every such tick */
    TROCAR_EVENT_TRACK_DROPPED = 1 << 13, /* there was no room for more tracks (TROCAR_MAX_TRACKS, TROCAR_MAX_TRACK_POINTS), so the needle's oldest track was
                                             dropped */
    TROCAR_EVENT_INEXACT = 1 << 14    /* the Newton passes did not converge, so the wrench's error may exceed the tolerance */
};

/* The result of a tick. */
typedef struct trocar_output {
    double force[3];         /* N, world frame: force that the needle's base exerts on the hand */
    double torque[3];        /* N m, world frame: torque on the hand about the base point */
    double depth;            /* m, length of the needle's current track in the tissue */
    int32_t contacts;        /* number of active contacts along the shaft, not counting the tip */
    uint32_t events;         /* TROCAR_EVENT_ bits */
    int32_t membrane;        /* index in the scene of the membrane punctured in this tick; -1 if none */
    int32_t passes;          /* number of Newton passes */
    int32_t switches;        /* how often contacts switched between sticking and sliding during the solve */
    int32_t reserved;        /* 0 */
} trocar_output;

/* Lockstep, for planners and batches: computes a tick of `dt` seconds (above 0, at most 1), then does the mesh update that the tick requested.
   Deterministic. BAD_INPUT as in trocar_sim_reset, and for a resting needle; NUMERIC if the mesh update fails. If the result is not finite, the
   insertion is restarted and the status is OK. [alone] */
TROCAR_API trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output,
                                         trocar_error *error);

/* Calls trocar_sim_step for each of `steps` poses. `watch` may be NULL; its functions are called every 64 steps. On error, the message names the step, and
   the outputs from that step on are zero. Errors as in trocar_sim_step, and CANCELLED. [alone] */
TROCAR_API trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch,
                                        trocar_output *outputs, trocar_error *error);

/* Real time: computes a tick using the worker's newest answer. BAD_INPUT, changing nothing, as in trocar_sim_step, and for a needle being left or taken that
   the worker has not handed over yet. NUMERIC if the result was not finite: the insertion is restarted at `base`, and the output is zero except for the
   UNSTABLE event. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);

/* A stack of this many bytes is enough for a thread that calls only functions marked [tick] and RT. */
enum { TROCAR_TICK_STACK = 512 * 1024 };

/* Sets the compliance (m/N) of a spring between the base and the pose given in each tick; 0, the default, holds the base rigidly. The spring is solved
   implicitly with the needle, so it may be arbitrarily stiff. [tick, RT] */
TROCAR_API void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance);

/* ---- the worker ---- */

/* What a call to trocar_sim_work did. */
typedef struct trocar_work {
    int32_t answered;        /* 1 if the call answered a request, 0 if there was none */
    int32_t more;            /* 1 if more work is pending */
    int32_t still_held;      /* 1 if a needle could not be left and stays held, because without the hand it has no equilibrium (NUMERIC) or would slip out
                                of the tissue (BAD_INPUT) */
    int64_t latency;         /* ns from request to answer, by the simulation's clock; 0 without a clock */
} trocar_work;

/* Answers the newest request, if there is one; otherwise prepares contact nodes ahead of the tip. `work` may be NULL. A call can take a long time. On error
   (NO_MEMORY, NUMERIC), the last answer remains in use. [work, allocates] */
TROCAR_API trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *work, trocar_error *error);

/* Returns a file descriptor that polls as readable while a request is pending. It belongs to the simulation. [any, RT] */
TROCAR_API int trocar_sim_work_descriptor(const trocar_sim *sim);

/* Returns the time in ns, by the simulation's clock, since the oldest unanswered request was made; 0 if all have been answered. [tick, RT] */
TROCAR_API int64_t trocar_sim_waiting(const trocar_sim *sim);

/* ---- save and restore ---- */

/* trocar_sim_save writes all mutable state to a buffer of `size` bytes; trocar_sim_state_size returns a size that is always enough. trocar_sim_restore reads
   it into any simulation of the same model, or of one built from an equal mesh and scene, even in another process. To store a state in a file, write only
   the first trocar_state_bytes bytes, about 10 to 300 kB. Call these functions between lockstep steps. BAD_INPUT, naming the cause, if `size` is too small,
   the model differs, or the state is damaged or was written by a library version with another format; NO_MEMORY. [alone] */
TROCAR_API size_t trocar_sim_state_size(const trocar_sim *sim);
TROCAR_API trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error);
TROCAR_API size_t trocar_state_bytes(const void *state); /* returns the actual size, in bytes, of a saved state. [any, RT] */

/* ---- measuring ---- */

/* Sets the clock used for measurements: a function that returns monotonic time in ns, called by the ticking thread and the worker. With NULL, the default,
   nothing is measured. [alone, RT] */
TROCAR_API void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void));

/* Returns the time in ns spent in each stage of the last tick. [tick, RT] */
enum { TROCAR_STAGE_TISSUE, TROCAR_STAGE_NEEDLE, TROCAR_STAGE_CONTACT, TROCAR_STAGE_WRENCH, TROCAR_STAGES };
TROCAR_API void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[4]);

#ifdef __cplusplus
}
#endif
#endif
