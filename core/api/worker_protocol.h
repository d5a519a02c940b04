/* What passes between the thread that ticks a simulation and its worker, and who has a needle. All memory that both threads touch is here.

   A needle is in one of five phases:

   | phase   | the needle is                      | the ticking thread writes     | the worker writes                                        |
   |---------|------------------------------------|-------------------------------|----------------------------------------------------------|
   | HELD    | ticked                             | state, requests, loads        | answers                                                  |
   | LEAVING | handed over, not at rest yet       | nothing (left before)         | the slot of the next answer, as scratch; shown at the end |
   | RESTING | in the tissue, and nobody's        | nothing                       | shown                                                    |
   | TAKING  | asked back                         | nothing                       | shown and one answer, at the end                         |
   | TAKEN   | the ticking thread's once adopted  | state, when it adopts what is shown | answers                                            |

   and goes from one to another by these events (-: refused, with the reason that link_refuses gives):

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

   The ticking thread changes the phase at any time; the worker's changes take effect only if the ticking thread has made none since the worker
   began (link_seen, link_complete). Whether the needle is attached to the tissue only the worker knows; what it has to do follows from that and
   the phase (link_duty). A restore sets any phase: it takes place between lockstep steps, where one thread is both. */
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
    ON_ADOPT,                /* the ticking thread goes on with the state that the worker shows */
    ON_RESTS,                /* the worker has attached it to the tissue; */
    ON_STAYS,                /* could not; */
    ON_RELEASE,              /* has detached it */
    NEEDLE_EVENTS
} needle_event;

/* NULL: the event is legal in this phase, and *next (may be NULL) is the phase after it; else why it is not. RT */
const char *phase_after(needle_phase phase, needle_event event, needle_phase *next);

/* What the worker has to do for a needle. */
typedef enum {
    DUTY_NONE,
    DUTY_REMOVE,             /* it was reset while it was attached: detach it, its forces vanish. Then look again */
    DUTY_LAY_DOWN,           /* let go of it and attach it */
    DUTY_RETURN,             /* detach it, and hand it back */
} needle_duty;

needle_duty duty_in(needle_phase phase, bool attached);

/* ---- messages ------------------------------------------------------------------------------------------------------------------ */

/* Ticking thread to worker. */
typedef struct {
    int64_t asked;           /* ns, by the simulation's clock */
    remesh_request request;
} posted_request;

/* Ticking thread to worker: a needle that is left. */
typedef struct {
    insertion_state state;
    track_list others;       /* tracks of other needles that its tip may come to */
} left_needle;

/* Worker to ticking thread: a needle that rests. */
typedef struct {
    uint64_t stamp;
    insertion_state state;
} shown_needle;

/* Worker to ticking thread: the probe. */
typedef struct {
    uint64_t stamp;
    trocar_probe told;
    int count, nodes[MAX_PRESSED]; /* that it presses, */
    vec3 force[MAX_PRESSED];       /* N, on the tissue */
} shown_probe;

/* Of what is shown: another number each time, in this process. RT */
uint64_t next_stamp(void);

/* ---- one needle ------------------------------------------------------------------------------------------------------------------ */

enum { REQUESTS_REMEMBERED = 1024 };

/* ns over which the others come to feel that the hand has let go of a needle: about what fingers take to open (an assumption). In one tick it
   would be a knock of up to 0.5 N. */
static const int64_t RELEASE_TIME = 100000000;

/* s, between two responses of what rests to the forces of held needles; longer while a probe presses so many nodes, which takes the worker longer. RT */
static inline double response_period(int pressed) { return pressed > 0 ? 0.01 : 0.004; }

typedef struct {
    atomic_uint phase;       /* needle_phase, and PHASES times how often the ticking thread has changed it: a needle that is reset and left
                                again while the worker lays it down is not the one that it lays down */
    triple_buffer requests;  /* posted_request: ticking thread -> worker */
    triple_buffer loads;     /* tissue_loads: ticking thread -> worker */
    triple_buffer left;      /* left_needle: ticking thread -> worker */
    triple_buffer answers;   /* compliance_snapshot: worker -> ticking thread */
    triple_buffer shown;     /* shown_needle: worker -> ticking thread */
    atomic_bool stale;       /* set by the worker, cleared by the ticking thread: what it was told no longer holds, and it asks again */
    atomic_llong since_release; /* ns that it has been ticked since another one was let go of: the ticking thread adds, the worker sets */
    /* The ticking thread's: */
    uint64_t posted;         /* serial of the last request handed over, */
    uint64_t answered;       /* and of the one that the last tick had the answer to */
    int64_t asked[REQUESTS_REMEMBERED]; /* ns, when the request of this serial (modulo) was handed over */
    tissue_loads posted_loads; /* forces as they were when they were last handed over */
} needle_link;

trocar_status link_create(needle_link *link, report *why);
void link_free(needle_link *link);

/* Only those in use: there is room for many. RT */
void copy_loads(const tissue_loads *from, tissue_loads *to);

/* ---- the ticking thread's side. All RT -------------------------------------------------------------------------------------------- */

needle_phase link_phase(const needle_link *link);

/* NULL, or why the event is not legal now. */
const char *link_refuses(const needle_link *link, needle_event event);

/* The newest answer; serial 0: none yet. */
const compliance_snapshot *link_answer(const needle_link *link);

/* What the worker shows of the needle; NULL while the ticking thread's own state is what there is to see. */
const shown_needle *link_shown(const needle_link *link);

/* Hands a request over if its serial is new or the last answer is stale. True: it did. */
bool link_post_request(needle_link *link, const remesh_request *request, int64_t now);

void link_post_loads(needle_link *link, const tissue_loads *loads);

/* The needle as it is left, to be filled in before link_leave. Valid in HELD. */
left_needle *link_left_slot(needle_link *link);

/* These change the phase. In a phase in which they are not legal they must not be called (link_refuses). */
void link_leave(needle_link *link, insertion_state *state); /* `state`: the ticking thread's, whose serials and ids it keeps apart from the worker's */
void link_take(needle_link *link);
void link_adopt(needle_link *link, insertion_state *state, tissue_loads *loads); /* `loads` are those of the state, which the worker has from the needle's rest */
bool link_reset(needle_link *link, uint64_t serial); /* `serial`: of the state's request after the reset. True: the worker had the needle */

/* ns since the oldest request was handed over that the last tick had no answer to; 0: there is none. `now`: by the clock of link_post_request. */
int64_t link_waiting(const needle_link *link, int64_t now);

/* ---- the worker's side ------------------------------------------------------------------------------------------------------------- */

/* The phase as the worker sees it before it begins; phase_seen gives the needle_phase in it. */
unsigned link_seen(const needle_link *link);
static inline needle_phase phase_seen(unsigned seen) { return (needle_phase)(seen % PHASES); }

/* The phase after an event of the worker's. No effect, and false, if the ticking thread has changed it since it was `seen`. */
bool link_complete(needle_link *link, unsigned seen, needle_event event);

/* The newest request; *fresh: it has not been read. */
const posted_request *link_request(needle_link *link, bool *fresh);
bool link_request_waits(needle_link *link); /* is there a newer one? */

/* The newest loads; *fresh (may be NULL) as above. */
const tissue_loads *link_loads(needle_link *link, bool *fresh);

const left_needle *link_left(needle_link *link);

/* Slots to fill, and to publish when they are filled. */
compliance_snapshot *link_answer_slot(needle_link *link);
void link_publish_answer(needle_link *link);
shown_needle *link_shown_slot(needle_link *link);
void link_publish_shown(needle_link *link);

void link_mark_stale(needle_link *link);

/* ---- both at once: after a restore, between lockstep steps -------------------------------------------------------------------------- */

void link_restore(needle_link *link, needle_phase phase, int64_t since_release);
void link_publish_left(needle_link *link); /* link_left_slot has been filled in for a needle in LEAVING */

/* ---- the probe ------------------------------------------------------------------------------------------------------------------------ */

typedef struct {
    triple_buffer poses;     /* pose: ticking thread -> worker */
    triple_buffer shown;     /* shown_probe: worker -> ticking thread */
    atomic_bool placed;      /* a pose has been asked for */
} probe_link;

void probe_link_post(probe_link *link, pose at);             /* ticking thread. RT */
const shown_probe *probe_link_shown(const probe_link *link); /* ticking thread. RT */
const pose *probe_link_pose(probe_link *link, bool *fresh);  /* worker: the newest one */
shown_probe *probe_link_slot(probe_link *link);              /* worker */
void probe_link_publish(probe_link *link);                   /* worker */

/* Between lockstep steps: the pose that waits for the worker, if one does, which goes on waiting. */
bool probe_link_waiting(probe_link *link, pose *at);
/* What waits is dropped; then a pose waits, unless it is NULL. */
void probe_link_restore(probe_link *link, bool placed, const pose *waiting);

/* ---- a simulation -------------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int wake;                /* eventfd, readable while the worker has something to do */
    atomic_int resting;      /* needles that rest; set by the worker */
    probe_link probe;
} sim_link;

trocar_status sim_link_create(sim_link *link, bool probe, report *why);
void sim_link_free(sim_link *link);                          /* also of one that is all zeros but for its wake, which is -1 */

void wake_worker(const sim_link *link);                      /* ticking thread. RT, but for one write() */
void worker_is_awake(const sim_link *link);                  /* worker, before it looks for what there is to do */

#endif
