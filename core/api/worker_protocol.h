/* The messages between the thread that ticks a simulation and its worker, and which of them owns each needle. The two threads exchange data only through the
   links below and through `changing` and `elasticity`, which carry values that change during a run and have their own rules. Every other member of the structs
   in api.h is constant or belongs to one thread.

   A needle is in one of five phases:

   | phase   | the needle is                      | the ticking thread writes        | the worker writes                                        |
   |---------|------------------------------------|----------------------------------|----------------------------------------------------------|
   | HELD    | ticked                             | state, requests, loads           | answers                                                  |
   | LEAVING | handed over, not at rest yet       | nothing (`left` has been written) | the slot of the next answer, as scratch; shown, at the end |
   | RESTING | in the tissue, held by no hand     | nothing                          | shown                                                    |
   | TAKING  | requested back                     | nothing                          | shown and one answer, at the end                         |
   | TAKEN   | returned, to be adopted            | state, by adopting the shown one | answers                                                  |

   These events change the phase (-: refused; link_refuses returns the reason):

   | event      | thread  | HELD    | LEAVING | RESTING | TAKING | TAKEN |
   |------------|---------|---------|---------|---------|--------|-------|
   | ON_TICK    | ticking | HELD    | -       | -       | -      | -     |
   | ON_LEAVE   | ticking | LEAVING | -       | -       | -      | -     |
   | ON_TAKE    | ticking | -       | -       | TAKING  | -      | -     |
   | ON_RESET   | ticking | HELD    | HELD    | HELD    | HELD   | -     |
   | ON_ADOPT   | ticking | -       | -       | -       | -      | HELD  |
   | ON_RESTS   | worker  | -       | RESTING | -       | -      | -     |
   | ON_STAYS   | worker  | -       | HELD    | -       | -      | -     |
   | ON_RELEASE | worker  | -       | -       | -       | TAKEN  | -     |

   The ticking thread may change the phase at any time, by a reset. The worker's changes take effect only if the ticking thread has not changed the phase since
   the worker began its task (link_seen, link_complete). Only the worker knows whether a needle is attached to the tissue; its task follows from that and the
   phase (duty_in). A restore may set any phase: it happens between lockstep steps, where one thread is both the ticking thread and the worker. */
#ifndef TROCAR_WORKER_PROTOCOL_H
#define TROCAR_WORKER_PROTOCOL_H

#include <stdatomic.h>

#include "base/triple_buffer.h"
#include "insertion/state/insertion_state.h"
#include "probe/probe.h"

/* ---- phases and events -------------------------------------------------------------------------------------------------------- */

typedef enum { PHASE_HELD, PHASE_LEAVING, PHASE_RESTING, PHASE_TAKING, PHASE_TAKEN, PHASES } needle_phase;

typedef enum {
    ON_TICK, ON_LEAVE, ON_TAKE, ON_RESET,
    ON_ADOPT,                /* the ticking thread continues with the state shown by the worker */
    ON_RESTS,                /* the worker has attached the needle to the tissue */
    ON_STAYS,                /* the worker could not attach the needle */
    ON_RELEASE,              /* the worker has detached the needle */
    NEEDLE_EVENTS
} needle_event;

/* If the event is legal in this phase, returns NULL and sets *next, unless `next` is NULL, to the phase after the event. Otherwise returns the reason for
   refusing it. RT */
const char *phase_after(needle_phase phase, needle_event event, needle_phase *next);

/* The worker's task for a needle. */
typedef enum {
    DUTY_NONE,
    DUTY_REMOVE,             /* the needle was reset while attached: detach it, so that its forces vanish, and then choose the next task */
    DUTY_LAY_DOWN,           /* release the base and attach the needle to the tissue */
    DUTY_RETURN,             /* detach the needle and return it to the ticking thread */
} needle_duty;

needle_duty duty_in(needle_phase phase, bool attached);

/* ---- messages ------------------------------------------------------------------------------------------------------------------ */

/* Message from the ticking thread to the worker: a request. */
typedef struct {
    int64_t asked;           /* time of the request, in ns on the simulation's clock */
    remesh_request request;
} posted_request;

/* Message from the ticking thread to the worker: a needle that is being left in the tissue. */
typedef struct {
    insertion_state state;
    track_list others;       /* tracks of the other needles near this one's tip */
} left_needle;

/* Message from the worker to the ticking thread: a resting needle. */
typedef struct {
    uint64_t stamp;
    insertion_state state;
} shown_needle;

/* Message from the worker to the ticking thread: the probe. */
typedef struct {
    uint64_t stamp;
    trocar_probe output;
    int count, nodes[MAX_PRESSED]; /* nodes that the probe presses on */
    vec3 force[MAX_PRESSED];       /* N, force on the tissue at each of these nodes */
} shown_probe;

/* Returns a number, unique in this process, that identifies a state. RT */
uint64_t next_stamp(void);

/* ---- one needle ------------------------------------------------------------------------------------------------------------------ */

enum { REQUESTS_REMEMBERED = 1024 };

/* ns. After a needle is released, the other needles come to feel it over this time, about as long as fingers take to open (an assumed value). All at once, it
   would be a jolt of up to 0.5 N. */
static const int64_t RELEASE_TIME = 100000000;

/* Returns the interval (s) at which resting needles respond to the forces of held needles. `pressed` is the number of points that the probe presses on; if
   there are any, the worker needs more time, so the interval is longer. RT */
static inline double response_period(int pressed) { return pressed > 0 ? 0.01 : 0.004; }

typedef struct {
    atomic_uint phase;       /* a needle_phase plus PHASES times the number of changes made by the ticking thread. From that number, the worker can tell if a
                                needle was reset and left again while it was being attached */
    triple_buffer requests;  /* posted_request: ticking thread -> worker */
    triple_buffer loads;     /* tissue_loads: ticking thread -> worker */
    triple_buffer holds;     /* needle_hold: ticking thread -> worker; only in scenes with a probe */
    triple_buffer left;      /* left_needle: ticking thread -> worker */
    triple_buffer answers;   /* compliance_snapshot: worker -> ticking thread */
    triple_buffer shown;     /* shown_needle: worker -> ticking thread */
    atomic_bool stale;       /* true if the last answer is no longer valid and the ticking thread must post a new request; set by the worker, cleared by the
                                ticking thread */
    atomic_llong since_release; /* ns, simulated time that this needle has ticked for since a needle was last released; increased by the ticking thread, reset
                                   by the worker */
    /* Used by the ticking thread: */
    uint64_t posted;         /* serial of the last posted request */
    uint64_t answered;       /* serial of the request whose answer the last tick used */
    int64_t asked[REQUESTS_REMEMBERED]; /* ns, when each remembered request was posted; indexed by its serial modulo REQUESTS_REMEMBERED */
    tissue_loads posted_loads; /* the needle's forces as last posted */
} needle_link;

/* `lockstep`: true if one thread is both the ticking thread and the worker; then the buffers are not prefaulted. */
trocar_status link_create(needle_link *link, bool lockstep, trocar_error *why);

/* Creates the buffer for needle_hold. In scenes with a probe, call it after link_create. */
trocar_status link_create_holds(needle_link *link, trocar_error *why);
void link_free(needle_link *link);

/* Copies only the entries in use, because the array is large. RT */
void copy_loads(const tissue_loads *from, tissue_loads *to);

/* ---- the ticking thread's side. All RT -------------------------------------------------------------------------------------------- */

needle_phase link_phase(const needle_link *link);

/* Returns NULL if the event is legal in the current phase; otherwise, the reason for refusing it. */
const char *link_refuses(const needle_link *link, needle_event event);

/* Returns the newest answer, emptied if it was for an earlier insertion. Its serial is 0 if there is no answer yet. */
const compliance_snapshot *link_answer(const needle_link *link, uint64_t insertion);

/* Returns the needle as last published by the worker; NULL if the ticking thread's own state is the one to show. */
const shown_needle *link_shown(const needle_link *link);

/* Posts the request if its serial is new or the last answer is stale. Returns true if it was posted. */
bool link_post_request(needle_link *link, const remesh_request *request, int64_t now);

void link_post_loads(needle_link *link, const tissue_loads *loads);

/* Returns the slot to fill before calling link_publish_hold. */
needle_hold *link_hold_slot(needle_link *link);
void link_publish_hold(needle_link *link);

/* Returns the slot to fill before calling link_leave. Valid in phase HELD. */
left_needle *link_left_slot(needle_link *link);

/* These functions change the phase. Do not call them when link_refuses() refuses their event. */
void link_leave(needle_link *link, insertion_state *state); /* `state`: the ticking thread's state; its next serial and id are increased, so that they differ
                                                               from any that the worker issues */
void link_take(needle_link *link);
void link_adopt(needle_link *link, insertion_state *state, tissue_loads *loads); /* `loads`: the forces in `state`. The worker already knows them, so they are
                                                                                    not posted */
bool link_reset(needle_link *link, uint64_t serial); /* `serial`: serial of the first request after the reset. Returns true if the needle was not held */

/* Returns the age (ns) of the oldest request that the last tick had no answer for; 0 if there is none. `now` must be by the same clock as in
   link_post_request. */
int64_t link_waiting(const needle_link *link, int64_t now);

/* ---- the worker's side ------------------------------------------------------------------------------------------------------------- */

/* Returns the phase and the change count as one number (see needle_link.phase). The worker reads it before starting a task; phase_seen() extracts the phase. */
unsigned link_seen(const needle_link *link);
static inline needle_phase phase_seen(unsigned seen) { return (needle_phase)(seen % PHASES); }

/* Applies one of the worker's events. If the ticking thread has changed the phase since `seen` was read, does nothing and returns false. */
bool link_complete(needle_link *link, unsigned seen, needle_event event);

/* Returns the newest request. Sets *fresh, unless `fresh` is NULL, to whether it is new since the last read. */
const posted_request *link_request(needle_link *link, bool *fresh);
bool link_request_waits(needle_link *link); /* true if there is a newer request than the one last read */

/* Returns the newest loads. Sets *fresh, unless `fresh` is NULL, to whether they are new since the last read. */
const tissue_loads *link_loads(needle_link *link, bool *fresh);

/* Returns the newest needle_hold, which is valid until the next call. */
const needle_hold *link_hold(needle_link *link);

const left_needle *link_left(needle_link *link);

/* The worker fills the returned slot and then publishes it. */
compliance_snapshot *link_answer_slot(needle_link *link);
void link_publish_answer(needle_link *link);
shown_needle *link_shown_slot(needle_link *link);
void link_publish_shown(needle_link *link);

void link_mark_stale(needle_link *link);

/* ---- both at once: after a restore, between lockstep steps -------------------------------------------------------------------------- */

void link_restore(needle_link *link, needle_phase phase, int64_t since_release);
void link_publish_left(needle_link *link); /* for a needle in phase LEAVING: publishes the slot from link_left_slot, which must have been filled */

/* ---- the probe ------------------------------------------------------------------------------------------------------------------------ */

typedef struct {
    triple_buffer poses;     /* pose: ticking thread -> worker */
    triple_buffer shown;     /* shown_probe: worker -> ticking thread */
    atomic_bool placed;      /* true if a pose has been posted */
    atomic_llong time;       /* ns, simulated time; set by the ticking thread */
} probe_link;

void probe_link_post(probe_link *link, pose at);             /* ticking thread. RT */
const shown_probe *probe_link_shown(const probe_link *link); /* ticking thread. RT */
const pose *probe_link_pose(probe_link *link, bool *fresh);  /* worker; returns the newest pose */
shown_probe *probe_link_slot(probe_link *link);              /* worker */
void probe_link_publish(probe_link *link);                   /* worker */

/* If a pose is pending for the worker, copies it to `at`, leaves it pending and returns true. Call it between lockstep steps. */
bool probe_link_waiting(probe_link *link, pose *at);
/* Replaces any pending pose with `waiting`, or with none if `waiting` is NULL. */
void probe_link_restore(probe_link *link, bool placed, const pose *waiting);

/* ---- a simulation -------------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int work_event;          /* eventfd that is readable while the worker has work to do; -1 in lockstep */
    atomic_int resting;      /* number of resting needles; set by the worker */
    probe_link probe;
} sim_link;

trocar_status sim_link_create(sim_link *link, bool probe, bool lockstep, trocar_error *why);
void sim_link_free(sim_link *link);                          /* `link` may be zero-initialised, with work_event = -1 */

void wake_worker(const sim_link *link);                      /* ticking thread. RT, except for one write() */
void worker_is_awake(const sim_link *link);                  /* worker; clears the event before looking for work */

#endif
