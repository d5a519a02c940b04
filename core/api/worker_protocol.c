#include "api/worker_protocol.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

/* ---- phases and events -------------------------------------------------------------------------------------------------------- */

enum { SERIALS_APART = 1 << 20 };      /* gap left for serials and ids that the worker issues while it has the needle */

typedef struct {
    bool legal;
    needle_phase next;
    const char *reason;
} transition;

#define TO(phase) {.legal = true, .next = PHASE_##phase}
#define NOT(why) {.reason = why}

static const char RESTS[] = "it is already resting", NOT_AT_REST[] = "it has not come to rest yet", NO_REST[] = "it is not resting",
                  NOT_HELD[] = "it is not held", ADOPT_FIRST[] = "it has been returned and must be adopted", NOT_BACK[] = "it has not been returned",
                  NOT_LEFT[] = "it is not being left", NOT_ASKED[] = "it has not been requested back";

static const transition TABLE[NEEDLE_EVENTS][PHASES] = {
    /*               HELD            LEAVING           RESTING         TAKING          TAKEN */
    [ON_TICK] =     {TO(HELD),       NOT(NOT_HELD),    NOT(NOT_HELD),  NOT(NOT_HELD),  NOT(ADOPT_FIRST)},
    [ON_LEAVE] =    {TO(LEAVING),    NOT(RESTS),       NOT(RESTS),     NOT(RESTS),     NOT(ADOPT_FIRST)},
    [ON_TAKE] =     {NOT(NO_REST),   NOT(NOT_AT_REST), TO(TAKING),     NOT(NO_REST),   NOT(NO_REST)},
    [ON_RESET] =    {TO(HELD),       TO(HELD),         TO(HELD),       TO(HELD),       NOT(ADOPT_FIRST)},
    [ON_ADOPT] =    {NOT(NOT_BACK),  NOT(NOT_BACK),    NOT(NOT_BACK),  NOT(NOT_BACK),  TO(HELD)},
    [ON_RESTS] =    {NOT(NOT_LEFT),  TO(RESTING),      NOT(NOT_LEFT),  NOT(NOT_LEFT),  NOT(NOT_LEFT)},
    [ON_STAYS] =    {NOT(NOT_LEFT),  TO(HELD),         NOT(NOT_LEFT),  NOT(NOT_LEFT),  NOT(NOT_LEFT)},
    [ON_RELEASE] =  {NOT(NOT_ASKED), NOT(NOT_ASKED),   NOT(NOT_ASKED), TO(TAKEN),      NOT(NOT_ASKED)},
};

#undef TO
#undef NOT

const char *phase_after(needle_phase phase, needle_event event, needle_phase *next) {
    const transition *t = &TABLE[event][phase];
    if (t->legal && next) *next = t->next;
    return t->reason;
}

needle_duty duty_in(needle_phase phase, bool attached) {
    if (attached && (phase == PHASE_HELD || phase == PHASE_LEAVING)) return DUTY_REMOVE;
    if (phase == PHASE_LEAVING) return DUTY_LAY_DOWN;
    return phase == PHASE_TAKING ? DUTY_RETURN : DUTY_NONE;
}

uint64_t next_stamp(void) {
    static atomic_uint_fast64_t last;
    return atomic_fetch_add_explicit(&last, 1, memory_order_relaxed) + 1;
}

/* ---- one needle ------------------------------------------------------------------------------------------------------------------ */

typedef trocar_status (*buffer_creator)(triple_buffer *, size_t, trocar_error *);

trocar_status link_create(needle_link *link, bool lockstep, trocar_error *why) {
    buffer_creator create = lockstep ? triple_buffer_create_sparse : triple_buffer_create;
    trocar_status status = create(&link->requests, sizeof(posted_request), why);
    if (status == TROCAR_OK) status = create(&link->answers, sizeof(compliance_snapshot), why);
    if (status == TROCAR_OK) status = create(&link->loads, sizeof(tissue_loads), why);
    if (status == TROCAR_OK) status = create(&link->left, sizeof(left_needle), why);
    if (status == TROCAR_OK) status = create(&link->shown, sizeof(shown_needle), why);
    return status;
}

trocar_status link_create_holds(needle_link *link, trocar_error *why) { return triple_buffer_create(&link->holds, sizeof(needle_hold), why); }

void link_free(needle_link *link) {
    triple_buffer_free(&link->holds);
    triple_buffer_free(&link->requests);
    triple_buffer_free(&link->answers);
    triple_buffer_free(&link->loads);
    triple_buffer_free(&link->left);
    triple_buffer_free(&link->shown);
}

void copy_loads(const tissue_loads *from, tissue_loads *to) {
    to->count = from->count;
    memcpy(to->loads, from->loads, (size_t)from->count * sizeof *from->loads);
}

/* ---- the ticking thread's side ----------------------------------------------------------------------------------------------------- */

needle_phase link_phase(const needle_link *link) { return phase_seen(link_seen(link)); }

const char *link_refuses(const needle_link *link, needle_event event) { return phase_after(link_phase(link), event, NULL); }

static void set_phase(needle_link *link, needle_phase phase) {
    unsigned before = atomic_load_explicit(&link->phase, memory_order_relaxed);
    atomic_store_explicit(&link->phase, before - before % PHASES + PHASES + (unsigned)phase, memory_order_release);
}

const compliance_snapshot *link_answer(const needle_link *link, uint64_t insertion) {
    compliance_snapshot *answer = (compliance_snapshot *)triple_buffer_read((triple_buffer *)&link->answers, NULL); /* until the next read, the slot is the
                                                                                                                       reader's to modify */
    if (answer->insertion != insertion) snapshot_empty(answer);
    return answer;
}

const shown_needle *link_shown(const needle_link *link) {
    needle_phase phase = link_phase(link);
    return phase == PHASE_HELD || phase == PHASE_LEAVING ? NULL : triple_buffer_read((triple_buffer *)&link->shown, NULL);
}

bool link_post_request(needle_link *link, const remesh_request *request, int64_t now) {
    uint64_t serial = request->serial;
    bool stale = atomic_load_explicit(&link->stale, memory_order_relaxed) && atomic_exchange_explicit(&link->stale, false, memory_order_acquire);
    if (serial == link->posted && !stale) return false;
    posted_request *slot = triple_buffer_slot(&link->requests);
    slot->asked = now;
    slot->request = *request;
    triple_buffer_publish(&link->requests);
    if (serial - link->posted > REQUESTS_REMEMBERED) link->posted = serial - REQUESTS_REMEMBERED; /* keeps the loop below short after a restore */
    while (link->posted < serial) link->asked[++link->posted % REQUESTS_REMEMBERED] = now;
    return true;
}

void link_post_loads(needle_link *link, const tissue_loads *loads) {
    copy_loads(loads, triple_buffer_slot(&link->loads));
    triple_buffer_publish(&link->loads);
    copy_loads(loads, &link->posted_loads);
}

needle_hold *link_hold_slot(needle_link *link) { return triple_buffer_slot(&link->holds); }
void link_publish_hold(needle_link *link) { triple_buffer_publish(&link->holds); }

left_needle *link_left_slot(needle_link *link) { return triple_buffer_slot(&link->left); }

void link_publish_left(needle_link *link) { triple_buffer_publish(&link->left); }

void link_leave(needle_link *link, insertion_state *state) {
    link_publish_left(link);
    state->request.serial += SERIALS_APART;
    state->next_id += SERIALS_APART;
    set_phase(link, PHASE_LEAVING);
}

void link_take(needle_link *link) { set_phase(link, PHASE_TAKING); }

void link_adopt(needle_link *link, insertion_state *state, tissue_loads *loads) {
    link->posted = link->answered = state->request.serial;
    copy_loads(loads, &link->posted_loads);
    set_phase(link, PHASE_HELD);
}

/* Changes the phase to HELD. The caller must not post empty loads before this, because the worker does not read the loads of a resting needle. */
bool link_reset(needle_link *link, uint64_t serial) {
    bool away = link_phase(link) != PHASE_HELD;
    if (away) {
        link->posted = link->answered = serial - 1;
        set_phase(link, PHASE_HELD);
    }
    return away;
}

int64_t link_waiting(const needle_link *link, int64_t now) {
    if (link->answered >= link->posted || link_phase(link) != PHASE_HELD) return 0;
    /* serial of the oldest unanswered request or, if that one has been forgotten, of the oldest one remembered */
    uint64_t oldest = link->posted - link->answered < REQUESTS_REMEMBERED ? link->answered + 1 : link->posted + 1;
    return now - link->asked[oldest % REQUESTS_REMEMBERED];
}

/* ---- the worker's side ------------------------------------------------------------------------------------------------------------- */

unsigned link_seen(const needle_link *link) { return atomic_load_explicit(&link->phase, memory_order_acquire); }

bool link_complete(needle_link *link, unsigned seen, needle_event event) {
    needle_phase next = phase_seen(seen);
    if (phase_after(phase_seen(seen), event, &next)) return false;
    return atomic_compare_exchange_strong(&link->phase, &seen, seen - seen % PHASES + (unsigned)next);
}

const posted_request *link_request(needle_link *link, bool *fresh) { return triple_buffer_read(&link->requests, fresh); }
bool link_request_waits(needle_link *link) { return triple_buffer_waits(&link->requests); }
const tissue_loads *link_loads(needle_link *link, bool *fresh) { return triple_buffer_read(&link->loads, fresh); }
const needle_hold *link_hold(needle_link *link) { return triple_buffer_read(&link->holds, NULL); }
const left_needle *link_left(needle_link *link) { return triple_buffer_read(&link->left, NULL); }
compliance_snapshot *link_answer_slot(needle_link *link) { return triple_buffer_slot(&link->answers); }
void link_publish_answer(needle_link *link) { triple_buffer_publish(&link->answers); }
shown_needle *link_shown_slot(needle_link *link) { return triple_buffer_slot(&link->shown); }
void link_publish_shown(needle_link *link) { triple_buffer_publish(&link->shown); }
void link_mark_stale(needle_link *link) { atomic_store_explicit(&link->stale, true, memory_order_release); }

/* ---- both at once ------------------------------------------------------------------------------------------------------------------- */

void link_restore(needle_link *link, needle_phase phase, int64_t since_release) {
    link->posted = 0;
    atomic_store(&link->since_release, since_release);
    set_phase(link, phase);
}

/* ---- the probe ------------------------------------------------------------------------------------------------------------------------ */

void probe_link_post(probe_link *link, pose at) {
    memcpy(triple_buffer_slot(&link->poses), &at, sizeof at);
    triple_buffer_publish(&link->poses);
    atomic_store_explicit(&link->placed, true, memory_order_relaxed);
}

const shown_probe *probe_link_shown(const probe_link *link) { return triple_buffer_read((triple_buffer *)&link->shown, NULL); }
const pose *probe_link_pose(probe_link *link, bool *fresh) { return triple_buffer_read(&link->poses, fresh); }
shown_probe *probe_link_slot(probe_link *link) { return triple_buffer_slot(&link->shown); }
void probe_link_publish(probe_link *link) { triple_buffer_publish(&link->shown); }

bool probe_link_waiting(probe_link *link, pose *at) {
    if (!triple_buffer_waits(&link->poses)) return false;
    memcpy(at, triple_buffer_read(&link->poses, NULL), sizeof *at); /* reading the pose consumes it, so post it again */
    memcpy(triple_buffer_slot(&link->poses), at, sizeof *at);
    triple_buffer_publish(&link->poses);
    return true;
}

void probe_link_restore(probe_link *link, bool placed, const pose *waiting) {
    triple_buffer_read(&link->poses, NULL);
    atomic_store(&link->placed, placed);
    if (waiting) probe_link_post(link, *waiting);
}

/* ---- a simulation -------------------------------------------------------------------------------------------------------------------- */

trocar_status sim_link_create(sim_link *link, bool probe, bool lockstep, trocar_error *why) {
    link->work_event = lockstep ? -1 : eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (!lockstep && link->work_event < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    if (!probe) return TROCAR_OK;
    trocar_status status = triple_buffer_create(&link->probe.poses, sizeof(pose), why);
    return status == TROCAR_OK ? triple_buffer_create(&link->probe.shown, sizeof(shown_probe), why) : status;
}

void sim_link_free(sim_link *link) {
    triple_buffer_free(&link->probe.poses);
    triple_buffer_free(&link->probe.shown);
    if (link->work_event >= 0) close(link->work_event);
}

void wake_worker(const sim_link *link) {
    uint64_t one = 1;
    if (link->work_event < 0) return;
    ssize_t written = write(link->work_event, &one, sizeof one); /* fails only if the counter is full, and then the worker is awake anyway */
    (void)written;
}

void worker_is_awake(const sim_link *link) {
    uint64_t count;
    if (link->work_event < 0) return;
    ssize_t taken = read(link->work_event, &count, sizeof count);
    (void)taken;
}
