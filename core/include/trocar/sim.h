/* Simulations: needles and their effect on the tissue, ticks, and the worker. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_SIM_H
#define TROCAR_PUBLIC_SIM_H

#include "trocar/model.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The needles of a scene and their effect on the tissue. `needle` is an index everywhere, from 0. */
typedef struct trocar_sim trocar_sim;

enum { TROCAR_MAX_NEEDLES = 32, TROCAR_MAX_GUIDES = 8 };

/* ---- creation ---- */

/* Every needle is straight, with its base at the origin, until it is reset. NO_MEMORY; BAD_INPUT for a model with mesh_only. [any, allocates] */
TROCAR_API trocar_status trocar_sim_create(trocar_model *model, trocar_sim **sim, trocar_error *error);
TROCAR_API void trocar_sim_free(trocar_sim *sim); /* [alone] */

/* Makes the needle straight at `base`, and the tissue as if it had never been there; seeds and other needles stay. In tissue it counts as inserted along
   its axis, without force. BAD_INPUT if `needle` is out of range, or the pose is not finite or not of unit length (1e-3). [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_reset(trocar_sim *sim, int needle, const trocar_pose *base, trocar_error *error);

/* ---- ticks ---- */

/* What happened in a tick: bits of trocar_output.events. */
enum {
    TROCAR_EVENT_TOUCHED = 1 << 0,    /* the tip met the outer surface */
    TROCAR_EVENT_PUNCTURED = 1 << 1,  /* a membrane gave way: trocar_output.membrane */
    TROCAR_EVENT_ADDED = 1 << 2,      /* a contact became active */
    TROCAR_EVENT_REMOVED = 1 << 3,    /* a contact slipped off the tip */
    TROCAR_EVENT_EXITED = 1 << 4,     /* the tip left the tissue on the far side */
    TROCAR_EVENT_REENTERED = 1 << 5,  /* and came back */
    TROCAR_EVENT_WITHDRAWN = 1 << 6,  /* the needle left the tissue the way it came in */
    TROCAR_EVENT_LATE = 1 << 7,       /* the worker has not answered for the tissue at the tip yet: the tick used its last answer, or an estimate */
    TROCAR_EVENT_FULL = 1 << 8,       /* no contact is left to add (TROCAR_MAX_CONTACTS), or the track has more than 256 layers */
    TROCAR_EVENT_UNSTABLE = 1 << 9,   /* the result was not finite: the insertion starts over */
    TROCAR_EVENT_KEPT = 1 << 10,      /* no longer set */
    TROCAR_EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes a guide's plate outside its holes, and is not guided: in every tick */
    TROCAR_EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is pushed into a body from the side, where it bears no force: in every tick */
    TROCAR_EVENT_TRACK_DROPPED = 1 << 13, /* no room for more tracks (TROCAR_MAX_TRACKS, TROCAR_MAX_TRACK_POINTS): the needle's oldest one is closed again */
    TROCAR_EVENT_INEXACT = 1 << 14    /* the passes did not converge: the wrench may be off by more than the tolerance */
};

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

/* Lockstep, for planners and batches: a tick of `dt` seconds (above 0, at most 1) and the mesh update that it requests. Deterministic. BAD_INPUT as in
   reset, and for a resting needle; NUMERIC if the mesh update fails. A result that is not finite restarts the insertion; the status is OK. [alone] */
TROCAR_API trocar_status trocar_sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output,
                                         trocar_error *error);

/* Calls trocar_sim_step for each of `steps` poses; `watch` may be NULL, and is called every 64 steps. On an error the message names the step, and outputs
   are zero from there on. Errors as in step, and CANCELLED. [alone] */
TROCAR_API trocar_status trocar_sim_run(trocar_sim *sim, int needle, const trocar_pose *poses, int steps, double dt, const trocar_watch *watch,
                                        trocar_output *outputs, trocar_error *error);

/* Real time: a tick with the worker's newest answer. BAD_INPUT, without effect, as in step, and for a needle that the worker has not handed over yet.
   NUMERIC if the result was not finite: the insertion restarts at `base`, and the output is zero except UNSTABLE. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_tick(trocar_sim *sim, int needle, const trocar_pose *base, double dt, trocar_output *output);

/* Bytes of stack that suffice for the thread that ticks: all functions marked [tick] and RT, in a thread that does nothing else. */
enum { TROCAR_TICK_STACK = 512 * 1024 };

/* Holds the base by a spring of this compliance, m/N, whose other end is at the pose given to each tick; 0, the default: rigidly. It is solved together
   with the needle, so it may be arbitrarily stiff. [tick, RT] */
TROCAR_API void trocar_sim_set_base_compliance(trocar_sim *sim, int needle, double compliance);

/* ---- the worker ---- */

/* Result of a call of trocar_sim_work. */
typedef struct trocar_work {
    int32_t answered;        /* 1: it answered a request; 0: there was none */
    int32_t more;            /* 1: more work is pending */
    int32_t still_held;      /* 1: a needle to be left finds no equilibrium without the hand (NUMERIC), or slips out of the tissue
                                (BAD_INPUT): it is held as before */
    int64_t latency;         /* ns from that request to its answer, by the simulation's clock; 0 without a clock */
} trocar_work;

/* Serves the newest request if there is one, else prepares nodes ahead along the needle's line. `work` may be NULL. May take long. After an error
   (NO_MEMORY, NUMERIC) the last answer stays in use. [work, allocates] */
TROCAR_API trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *work, trocar_error *error);

/* A descriptor for poll(): readable while a request waits. It belongs to the simulation. [any, RT] */
TROCAR_API int trocar_sim_work_descriptor(const trocar_sim *sim);

/* ns since the oldest request that is not answered yet, by the simulation's clock; 0 if all are answered. [tick, RT] */
TROCAR_API int64_t trocar_sim_waiting(const trocar_sim *sim);

/* ---- save and restore ---- */

/* Saves everything that changes into `size` bytes, trocar_sim_state_size of them, of the caller's memory, and restores it in any simulation of the same
   model in this process. Between lockstep steps. BAD_INPUT for a wrong size or another model's state. [alone] */
TROCAR_API size_t trocar_sim_state_size(const trocar_sim *sim);
TROCAR_API trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error);
TROCAR_API trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error);

/* ---- measuring ---- */

/* Sets the simulation's clock: monotonic ns, called from the ticking thread and the worker's; NULL, the default: nothing is measured. [alone, RT] */
TROCAR_API void trocar_sim_set_clock(trocar_sim *sim, int64_t (*clock)(void));

/* ns spent in the stages of the last tick. [tick, RT] */
enum { TROCAR_STAGE_TISSUE, TROCAR_STAGE_NEEDLE, TROCAR_STAGE_CONTACT, TROCAR_STAGE_WRENCH, TROCAR_STAGES };
TROCAR_API void trocar_sim_stages(const trocar_sim *sim, int64_t nanoseconds[4]);

#ifdef __cplusplus
}
#endif
#endif
