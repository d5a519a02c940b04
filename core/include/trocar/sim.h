/* Simulations: needles and their effect on the tissue, ticks, and the worker thread's tasks. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SIM_H
#define TROCAR_PUBLIC_SIM_H

#include "trocar/model.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The needles of a scene and their effect on the tissue. The argument `needle` is always an index, counted from 0. */
typedef struct trocar_sim trocar_sim;

enum { TROCAR_MAX_NEEDLES = 32, TROCAR_MAX_GUIDES = 8 };

/* ---- creation ---- */

/* Creates a simulation in which every needle is straight, with its base at the origin, until it is reset. NO_MEMORY; BAD_INPUT for a model with mesh_only.
   [any, allocates] */
TROCAR_API trocar_status trocar_sim_create(trocar_model *model, trocar_sim **sim, trocar_error *error);
TROCAR_API void trocar_sim_free(trocar_sim *sim); /* [alone] */

/* Makes the needle straight at `base`, and restores the tissue as if this needle had never touched it; seeds and other needles stay. If the needle overlaps the
   tissue, it counts as inserted along its axis without force. BAD_INPUT if `needle` is out of range, or if the pose is not finite or its quaternion is not
   of unit length (within 1e-3). [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error);

/* ---- ticks ---- */

/* Events during a tick: bits of trocar_output.events. */
enum {
    TROCAR_EVENT_TOUCHED = 1 << 0,    /* the tip met the outer surface */
    TROCAR_EVENT_PUNCTURED = 1 << 1,  /* a membrane was punctured; trocar_output.membrane is its index */
    TROCAR_EVENT_ADDED = 1 << 2,      /* a contact became active */
    TROCAR_EVENT_REMOVED = 1 << 3,    /* a contact was removed because the tip returned to it */
    TROCAR_EVENT_EXITED = 1 << 4,     /* the tip left the tissue on the far side */
    TROCAR_EVENT_REENTERED = 1 << 5,  /* the tip returned to the tissue the way it had left */
    TROCAR_EVENT_WITHDRAWN = 1 << 6,  /* the needle was withdrawn from the tissue through its entry */
    TROCAR_EVENT_LATE = 1 << 7,       /* the worker has not yet answered the request for the tissue at the tip: the tick used the last answer, or an estimate */
    TROCAR_EVENT_FULL = 1 << 8,       /* no more contacts can be added (TROCAR_MAX_CONTACTS), or the track has more than 256 layers */
    TROCAR_EVENT_UNSTABLE = 1 << 9,   /* the result was not finite, so the insertion restarts */
    TROCAR_EVENT_KEPT = 1 << 10,      /* no longer set */
    TROCAR_EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes through a guide's plate outside its holes and is not guided; set in every such tick */
    TROCAR_EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is pushed into a body from the side; the model computes no force for this; set in every such tick */
    TROCAR_EVENT_TRACK_DROPPED = 1 << 13, /* there was no room for more tracks (TROCAR_MAX_TRACKS, TROCAR_MAX_TRACK_POINTS), so the needle's oldest track was
                                             dropped */
    TROCAR_EVENT_INEXACT = 1 << 14    /* the passes did not converge: the error in the wrench may exceed the tolerance */
};

/* The result of a tick. */
typedef struct trocar_output {
    double force[3];         /* N, world frame: force of the needle's base on the hand */
    double torque[3];        /* N m, world frame: torque on the hand about the base point */
    double depth;            /* m, length of the needle's track in the tissue */
    int32_t contacts;        /* number of active contacts along the shaft, not counting the tip */
    uint32_t events;         /* TROCAR_EVENT_ bits */
    int32_t membrane;        /* index in the scene of the membrane punctured in this tick; -1 if none */
    int32_t passes;          /* Newton passes */
    int32_t switches;        /* number of changes between sticking and sliding during the solve */
    int32_t reserved;        /* 0 */
} trocar_output;

/* Lockstep, for planners and batches: computes a tick of `dt` seconds (above 0, at most 1), followed by the mesh update that the tick requests.
   Deterministic. BAD_INPUT as in trocar_sim_reset, and for a resting needle; NUMERIC if the mesh update fails. If the result is not finite, the
   insertion restarts and the status is OK. [alone] */
TROCAR_API trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output,
                                         trocar_error *error);

/* Calls trocar_sim_step for each of `steps` poses. `watch` may be NULL; its functions are called every 64 steps. After an error, the message names the
   step, and the outputs from that step on are zero. Errors as in trocar_sim_step, and CANCELLED. [alone] */
TROCAR_API trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch,
                                        trocar_output *outputs, trocar_error *error);

/* Real time: computes a tick with the worker's newest answer. BAD_INPUT, without effect, as in trocar_sim_step, and for a needle being left or taken
   that the worker has not handed over yet. NUMERIC if the result was not finite: the insertion restarts at `base`, and the output is zero except for the
   event UNSTABLE. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);

/* Sufficient stack size, in bytes, for a thread that only calls functions marked [tick] and RT. */
enum { TROCAR_TICK_STACK = 512 * 1024 };

/* Attaches the base to the pose given in each tick by a spring with this compliance (m/N); 0, the default, holds the base rigidly. The spring is solved
   together with the needle, so it may be arbitrarily stiff. [tick, RT] */
TROCAR_API void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance);

/* ---- the worker ---- */

/* Result of a call to trocar_sim_work. */
typedef struct trocar_work {
    int32_t answered;        /* 1 if the call answered a request, 0 if there was none */
    int32_t more;            /* 1 if more work is pending */
    int32_t still_held;      /* 1 if a needle that was being left stays held, because it has no equilibrium without the hand (NUMERIC) or would slip out of the
                                tissue (BAD_INPUT) */
    int64_t latency;         /* ns on the simulation's clock from the answered request to its answer; 0 without a clock */
} trocar_work;

/* Answers the newest request, if there is one; otherwise prepares contact nodes ahead of the tip. `work` may be NULL. A call may take a long time. After an
   error (NO_MEMORY, NUMERIC) the last answer remains in use. [work, allocates] */
TROCAR_API trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *work, trocar_error *error);

/* Returns a descriptor for poll() that is readable while a request is pending. It belongs to the simulation. [any, RT] */
TROCAR_API int trocar_sim_work_descriptor(const trocar_sim *sim);

/* Returns the time in ns, on the simulation's clock, since the oldest unanswered request; 0 if all requests have been answered. [tick, RT] */
TROCAR_API int64_t trocar_sim_waiting(const trocar_sim *sim);

/* ---- save and restore ---- */

/* Save all mutable state to the caller's memory of `size` bytes (trocar_sim_state_size is always enough), and restore it in any simulation of the same model,
   or of a model built from an equal mesh and scene, even in another process. Only data in use are written: trocar_state_bytes returns the actual size of a
   saved state, about 10 to 300 kB, which is the number of bytes to store in a file. Call these functions between lockstep steps. BAD_INPUT, with the cause, if
   `size` is too small, if the model differs, or if the state is damaged or has the format of another version of the library; NO_MEMORY. [alone] */
TROCAR_API size_t trocar_sim_state_size(const trocar_sim *sim);
TROCAR_API trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error);
TROCAR_API size_t trocar_state_bytes(const void *state); /* Returns the size of a state written by trocar_sim_save, in bytes. [any, RT] */

/* ---- measuring ---- */

/* Sets the simulation's clock: a function that returns monotonic time in ns, called by the ticking thread and the worker. With NULL, the default, nothing
   is measured. [alone, RT] */
TROCAR_API void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void));

/* Returns the time in ns spent in each stage of the last tick. [tick, RT] */
enum { TROCAR_STAGE_TISSUE, TROCAR_STAGE_NEEDLE, TROCAR_STAGE_CONTACT, TROCAR_STAGE_WRENCH, TROCAR_STAGES };
TROCAR_API void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[4]);

#ifdef __cplusplus
}
#endif
#endif
