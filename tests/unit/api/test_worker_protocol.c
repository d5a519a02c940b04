/* Tests the needle states shared by the ticking thread and the worker. Covers every event in every phase, legal or refused, for a single link and through
   trocar.h, and both threads running concurrently, for ThreadSanitizer. */
#include "api/worker_protocol.h"

#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "host.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

/* The expected transitions, written down independently of the code: the letter of the phase after each event, or '-' if the event is refused. */
static const char LETTERS[] = "HLRTK"; /* one letter each for HELD, LEAVING, RESTING, TAKING and TAKEN */
static const char *const EXPECTED[NEEDLE_EVENTS] = {
    [ON_TICK] = "H----", [ON_LEAVE] = "L----", [ON_TAKE] = "--T--", [ON_RESET] = "HHHH-", [ON_ADOPT] = "----H",
    [ON_RESTS] = "-R---", [ON_STAYS] = "-H---", [ON_RELEASE] = "---K-",
};
static const char *const NAMES[NEEDLE_EVENTS] = {"tick", "leave", "take", "reset", "adopt", "rests", "stays", "release"};

static needle_phase expected(needle_phase phase, needle_event event) {
    const char *at = strchr(LETTERS, EXPECTED[event][phase]);
    return at && *at ? (needle_phase)(at - LETTERS) : PHASES;
}

/* ---- a link by itself -------------------------------------------------------------------------------------------------------- */

typedef struct {
    needle_link link;
    insertion_state *state;
    tissue_loads loads;
} single;

static void open_single(single *s) {
    memset(s, 0, sizeof *s);
    s->state = calloc(1, sizeof *s->state);
    assert_non_null(s->state);
    OK(link_create(&s->link, false, &why));
}

static void close_single(single *s) {
    link_free(&s->link);
    free(s->state);
}

/* Executes a legal event. */
static void carry_out(single *s, needle_event event) {
    switch (event) {
    case ON_TICK: s->state->request.serial++, link_post_request(&s->link, &s->state->request, 0); return;
    case ON_LEAVE: link_leave(&s->link, s->state); return;
    case ON_TAKE: link_take(&s->link); return;
    case ON_RESET: link_reset(&s->link, s->state->request.serial); return;
    case ON_ADOPT: link_adopt(&s->link, s->state, &s->loads); return;
    default: assert_true(link_complete(&s->link, link_seen(&s->link), event));
    }
}

/* Runs the events that lead from HELD to this phase. */
static void go_to(single *s, needle_phase phase) {
    static const needle_event way[] = {ON_LEAVE, ON_RESTS, ON_TAKE, ON_RELEASE};
    for (int i = 0; i < (int)phase; i++) carry_out(s, way[i]);
    assert_int_equal(link_phase(&s->link), phase);
}

static bool is_workers(needle_event event) { return event >= ON_RESTS; }

static void every_event_in_every_phase(void **unused) {
    (void)unused;
    for (needle_phase phase = 0; phase < PHASES; phase++)
        for (needle_event event = 0; event < NEEDLE_EVENTS; event++) {
            single s;
            open_single(&s);
            go_to(&s, phase);
            const char *reason = link_refuses(&s.link, event);
            needle_phase after = expected(phase, event), next = PHASES;
            if ((reason == NULL) != (after != PHASES)) fail_msg("%s in phase %d: %s", NAMES[event], phase, reason ? reason : "legal");
            assert_ptr_equal(phase_after(phase, event, &next), reason);
            assert_int_equal(next, after);
            if (reason) assert_true(strlen(reason) > 5);
            if (!reason) carry_out(&s, event);
            else if (is_workers(event)) assert_false(link_complete(&s.link, link_seen(&s.link), event));
            assert_int_equal(link_phase(&s.link), reason ? phase : after);
            close_single(&s);
        }
}

/* The ticking thread changes the phase after the worker has begun a task. The worker's result then has no effect, even if the needle has returned to its
   original phase by then. */
static void the_worker_ends_only_what_still_holds(void **unused) {
    (void)unused;
    static const needle_event changes[][6] = {
        {ON_RESET, NEEDLE_EVENTS}, {ON_RESET, ON_LEAVE, NEEDLE_EVENTS}, {ON_RESET, ON_LEAVE, ON_RESTS, ON_TAKE, NEEDLE_EVENTS},
    };
    for (needle_phase phase = PHASE_LEAVING; phase <= PHASE_TAKING; phase += 2)
        for (size_t c = 0; c < sizeof changes / sizeof *changes; c++)
            for (needle_event event = ON_RESTS; event < NEEDLE_EVENTS; event++) {
                single s;
                open_single(&s);
                go_to(&s, phase);
                unsigned seen = link_seen(&s.link);
                for (int i = 0; changes[c][i] != NEEDLE_EVENTS; i++) carry_out(&s, changes[c][i]);
                needle_phase now = link_phase(&s.link);
                assert_false(link_complete(&s.link, seen, event));
                assert_int_equal(link_phase(&s.link), now);
                close_single(&s);
            }
}

static void the_duty_follows_from_phase_and_attachment(void **unused) {
    (void)unused;
    static const needle_duty expected_duty[PHASES][2] = {
        [PHASE_HELD] = {DUTY_NONE, DUTY_REMOVE}, [PHASE_LEAVING] = {DUTY_LAY_DOWN, DUTY_REMOVE}, [PHASE_RESTING] = {DUTY_NONE, DUTY_NONE},
        [PHASE_TAKING] = {DUTY_RETURN, DUTY_RETURN}, [PHASE_TAKEN] = {DUTY_NONE, DUTY_NONE},
    };
    for (needle_phase phase = 0; phase < PHASES; phase++)
        for (int attached = 0; attached < 2; attached++) assert_int_equal(duty_in(phase, attached), expected_duty[phase][attached]);
}

static void requests_are_posted_once_and_their_age_is_known(void **unused) {
    (void)unused;
    single s;
    bool fresh;
    open_single(&s);
    s.state->request.serial = 1;
    assert_true(link_post_request(&s.link, &s.state->request, 100));
    assert_false(link_post_request(&s.link, &s.state->request, 110));
    assert_int_equal(link_waiting(&s.link, 150), 50);
    link_mark_stale(&s.link);
    assert_true(link_post_request(&s.link, &s.state->request, 120));
    assert_false(link_post_request(&s.link, &s.state->request, 130));
    assert_true(link_request_waits(&s.link));
    assert_int_equal(link_request(&s.link, &fresh)->request.serial, 1);
    assert_true(fresh && !link_request_waits(&s.link));
    s.link.answered = 1;
    assert_int_equal(link_waiting(&s.link, 200), 0);
    for (int i = 1; i <= 2 * REQUESTS_REMEMBERED; i++) { /* the age is that of the oldest request still remembered */
        s.state->request.serial++;
        assert_true(link_post_request(&s.link, &s.state->request, 1000 + i));
    }
    assert_int_equal(link_waiting(&s.link, 1000 + 2 * REQUESTS_REMEMBERED), REQUESTS_REMEMBERED - 1);
    uint64_t before = s.state->request.serial;
    carry_out(&s, ON_LEAVE);
    assert_true(s.state->request.serial > before + REQUESTS_REMEMBERED); /* a release reserves request numbers for the worker */
    assert_int_equal(link_waiting(&s.link, 1 << 20), 0);
    close_single(&s);
}

/* ---- a link between two threads -------------------------------------------------------------------------------------------------- */

enum { EVENTS = 30000, HUNDREDTHS = 100 };

typedef struct {
    needle_link link;
    atomic_bool stop;
    bool attached;           /* written by the worker */
    int duties[4];
    int outdated;            /* tasks that the ticking thread made obsolete with another command */
} two_threads;

static unsigned random_below(unsigned *seed, unsigned n) { return (*seed = *seed * 1664525u + 1013904223u) / 65536u % n; }

/* Writes the ticket into two fields of each object that is handed over. They are far apart in memory, so a torn copy is detected. */
static void label(insertion_state *state, uint64_t ticket) { state->next_id = state->request.serial = ticket; }
static bool is_labelled(const insertion_state *state, uint64_t ticket) { return state->next_id == ticket && state->request.serial == ticket; }

enum { RETURNED = 1 << 30 };

static bool worker_turn(two_threads *t, unsigned *seed) {
    unsigned seen = link_seen(&t->link);
    needle_duty duty = duty_in(phase_seen(seen), t->attached);
    t->duties[duty]++;
    if (duty == DUTY_REMOVE) t->attached = false;
    if (duty == DUTY_LAY_DOWN) {
        uint64_t ticket = link_left(&t->link)->state.request.serial;
        bool stays = random_below(seed, HUNDREDTHS) < 20;
        label(&link_shown_slot(&t->link)->state, ticket);
        if (!stays) link_publish_shown(&t->link);
        t->attached = !stays;
        if (random_below(seed, 4) == 0) sched_yield();
        t->outdated += !link_complete(&t->link, seen, stays ? ON_STAYS : ON_RESTS);
    }
    if (duty == DUTY_RETURN) {
        uint64_t ticket = link_left(&t->link)->state.request.serial;
        label(&link_shown_slot(&t->link)->state, ticket + RETURNED);
        link_answer_slot(&t->link)->serial = ticket + RETURNED;
        t->attached = false;
        link_publish_answer(&t->link);
        link_publish_shown(&t->link);
        if (random_below(seed, 4) == 0) sched_yield();
        t->outdated += !link_complete(&t->link, seen, ON_RELEASE);
    }
    bool fresh;
    const posted_request *posted = link_request(&t->link, &fresh);
    if (fresh && posted->request.tip.x != (double)posted->request.serial) abort();
    if (fresh && !t->attached) {
        compliance_snapshot *slot = link_answer_slot(&t->link);
        slot->serial = posted->request.serial;
        slot->residual_time = (double)slot->serial;
        link_publish_answer(&t->link);
    }
    const tissue_loads *loads = link_loads(&t->link, &fresh);
    for (int i = 0; fresh && i < loads->count; i++)
        if (loads->loads[i].force.x != loads->count) abort();
    if (random_below(seed, 16) == 0) link_mark_stale(&t->link);
    return duty != DUTY_NONE;
}

static void *work_at_random(void *context) {
    two_threads *t = context;
    unsigned seed = 7;
    while (!atomic_load(&t->stop))
        if (!worker_turn(t, &seed)) sched_yield();
    while (worker_turn(t, &seed)) {}
    return NULL;
}

static bool all_happened(const int *counts, int count) {
    for (int i = 0; i < count; i++)
        if (counts[i] == 0) return false;
    return true;
}

/* The ticking thread issues commands at random times until it has seen every phase, however late the worker is scheduled. The needle shown to it must always
   be in the state in which it was last released. */
static void both_threads_agree_on_who_has_the_needle(void **unused) {
    (void)unused;
    two_threads *t = aligned_alloc(CACHE_LINE, (sizeof *t + CACHE_LINE - 1) / CACHE_LINE * CACHE_LINE);
    insertion_state *state = calloc(1, sizeof *state);
    tissue_loads loads = {.count = 0};
    pthread_t thread;
    unsigned seed = 1;
    uint64_t ticket = 0;
    int met[PHASES] = {0}, done[NEEDLE_EVENTS] = {0};
    assert_true(t && state);
    memset(t, 0, sizeof *t);
    OK(link_create(&t->link, false, &why));
    assert_int_equal(pthread_create(&thread, NULL, work_at_random, t), 0);
    for (int i = 0; i < EVENTS || !all_happened(met, PHASES) || !all_happened(done, ON_ADOPT + 1); i++) {
        needle_event event = (needle_event)random_below(&seed, ON_ADOPT + 1);
        needle_phase before = link_phase(&t->link);
        met[before]++;
        if (before == PHASE_RESTING) assert_true(is_labelled(&link_shown(&t->link)->state, ticket)); /* only this thread can end PHASE_RESTING */
        if (before == PHASE_TAKEN) {
            assert_true(is_labelled(&link_shown(&t->link)->state, ticket + RETURNED));
            assert_int_equal(link_answer(&t->link, 0)->serial, ticket + RETURNED);
        }
        if (random_below(&seed, 8) == 0) sched_yield();
        if (link_refuses(&t->link, event)) continue;
        done[event]++;
        switch (event) {
        case ON_TICK:
            state->request.tip.x = (double)++state->request.serial;
            link_post_request(&t->link, &state->request, i);
            loads.count = (int)random_below(&seed, 9);
            for (int k = 0; k < loads.count; k++) loads.loads[k].force.x = loads.count;
            link_post_loads(&t->link, &loads);
            break;
        case ON_LEAVE:
            ticket += 2 * (1 << 20); /* more than link_leave skips, so tickets never repeat */
            label(&link_left_slot(&t->link)->state, ticket);
            link_leave(&t->link, state);
            break;
        case ON_TAKE: link_take(&t->link); break;
        case ON_RESET: link_reset(&t->link, state->request.serial); break;
        default: link_adopt(&t->link, state, &loads);
        }
        needle_phase after = link_phase(&t->link), to = expected(before, event);
        bool workers = after == PHASE_RESTING || after == PHASE_TAKEN || (event == ON_LEAVE && after == PHASE_HELD);
        if (!workers && to != PHASES && after != to) fail_msg("%s in phase %d led to %d", NAMES[event], before, after);
    }
    if (link_phase(&t->link) == PHASE_TAKEN) link_adopt(&t->link, state, &loads);
    if (!link_refuses(&t->link, ON_RESET)) link_reset(&t->link, state->request.serial);
    atomic_store(&t->stop, true);
    pthread_join(thread, NULL);
    needle_phase last = link_phase(&t->link);
    assert_true(last == PHASE_HELD || last == PHASE_TAKEN); /* TAKEN if the worker finished before the last command */
    assert_false(t->attached);
    print_message("phases met %d %d %d %d %d, laid down %d, returned %d, removed %d, outdated %d\n", met[0], met[1], met[2], met[3], met[4],
                  t->duties[DUTY_LAY_DOWN], t->duties[DUTY_RETURN], t->duties[DUTY_REMOVE], t->outdated);
    link_free(&t->link);
    free(state);
    free(t);
}

/* ---- through trocar.h --------------------------------------------------------------------------------------------------------------- */

enum { NEEDLES = 2 };

typedef enum { TICK, STEP, LEAVE, TAKE, RESET, DROP, SAVE, CALLS } call;

/* Outcome of a call in one phase: its status, the needle's state right after the call and once the worker has finished, and words that the message contains. */
typedef struct {
    trocar_status status;
    trocar_needle_state at_once, in_the_end;
    const char *words;
} outcome;

#define GOES(now, end) {TROCAR_OK, TROCAR_NEEDLE_##now, TROCAR_NEEDLE_##end, NULL}
#define STAYS(now, end, words) {TROCAR_BAD_INPUT, TROCAR_NEEDLE_##now, TROCAR_NEEDLE_##end, words}
static const outcome OUTCOMES[CALLS][PHASES] = {
    /*         HELD                                 LEAVING                                      RESTING                                    TAKING                                     TAKEN */
    [TICK] =  {GOES(HELD, HELD),                    STAYS(LEAVING, RESTING, NULL),               STAYS(RESTING, RESTING, NULL),             STAYS(TAKING, HELD, NULL),                 GOES(HELD, HELD)},
    [STEP] =  {GOES(HELD, HELD),                    STAYS(RESTING, RESTING, "take it first"),    STAYS(RESTING, RESTING, "take it first"),  GOES(HELD, HELD),                          GOES(HELD, HELD)},
    [LEAVE] = {GOES(LEAVING, RESTING),              STAYS(LEAVING, RESTING, "already resting"),    STAYS(RESTING, RESTING, "already resting"),  STAYS(TAKING, HELD, "already resting"),      GOES(LEAVING, RESTING)},
    [TAKE] =  {STAYS(HELD, HELD, "not resting"),  STAYS(LEAVING, RESTING, "not come to rest"), GOES(TAKING, HELD),                        STAYS(TAKING, HELD, "not resting"),      STAYS(HELD, HELD, "not resting")},
    [RESET] = {GOES(HELD, HELD),                    GOES(HELD, HELD),                            GOES(HELD, HELD),                          GOES(HELD, HELD),                          GOES(HELD, HELD)},
    [DROP] =  {GOES(HELD, HELD),                    STAYS(LEAVING, RESTING, "take it first"),    STAYS(RESTING, RESTING, "take it first"),  STAYS(TAKING, HELD, "take it first"),      GOES(HELD, HELD)},
    [SAVE] =  {GOES(HELD, HELD),                    GOES(LEAVING, RESTING),                      GOES(RESTING, RESTING),                    GOES(TAKING, HELD),                        GOES(HELD, HELD)},
};

static const trocar_pose AWAY = {{0, 0, -10}, {1, 0, 0, 0}};

static void work_off(trocar_sim *sim) {
    trocar_work work = {.more = 1};
    for (int i = 0; work.more; i++) {
        assert_true(i < 10000);
        OK(trocar_sim_work(sim, &work, &why));
    }
}

static trocar_pose push_in(trocar_sim *sim) {
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    trocar_output out;
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int i = 0; i < 300; i++) {
        base.position[2] += 1e-4;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    }
    assert_true(out.contacts > 1);
    return base;
}

static void lead_to(trocar_sim *sim, needle_phase phase) {
    if (phase == PHASE_HELD) return;
    OK(trocar_sim_leave(sim, 0, &why));
    if (phase == PHASE_LEAVING) return;
    work_off(sim);
    if (phase == PHASE_RESTING) return;
    OK(trocar_sim_take(sim, 0, &why));
    if (phase == PHASE_TAKEN) work_off(sim);
}

static trocar_status make(trocar_sim *sim, call what, const trocar_pose *base, void *memory, size_t size) {
    trocar_output out;
    switch (what) {
    case TICK: return trocar_sim_tick(sim, 0, base, 1e-3, &out);
    case STEP: return trocar_sim_step(sim, 0, base, 1e-3, &out, &why);
    case LEAVE: return trocar_sim_leave(sim, 0, &why);
    case TAKE: return trocar_sim_take(sim, 0, &why);
    case RESET: return trocar_sim_reset(sim, 0, &AWAY, &why);
    case DROP: return trocar_sim_drop_seeds(sim, 0, 1, 0.0, &why);
    default: OK(trocar_sim_save(sim, memory, size, &why)); return trocar_sim_restore(sim, memory, size, &why);
    }
}

static void every_call_in_every_phase(void **unused) {
    (void)unused;
    host h = host_open_with(MESHES "/figure8.yaml", "needles", "2");
    size_t size = trocar_sim_state_size(h.sim);
    void *held = malloc(size), *memory = malloc(size);
    assert_true(held && memory);
    trocar_pose base = push_in(h.sim);
    OK(trocar_sim_save(h.sim, held, size, &why));
    for (needle_phase phase = 0; phase < PHASES; phase++)
        for (call what = 0; what < CALLS; what++) {
            const outcome *o = &OUTCOMES[what][phase];
            OK(trocar_sim_restore(h.sim, held, size, &why));
            lead_to(h.sim, phase);
            why.text[0] = '\0';
            trocar_status status = make(h.sim, what, &base, memory, size);
            if (status != o->status) fail_msg("call %d in phase %d: %d: %s", what, phase, status, why.text);
            if (o->words && !strstr(why.text, o->words)) fail_msg("call %d in phase %d: %s", what, phase, why.text);
            if (trocar_sim_needle_state(h.sim, 0) != o->at_once) fail_msg("call %d in phase %d: then %d", what, phase, trocar_sim_needle_state(h.sim, 0));
            work_off(h.sim);
            if (trocar_sim_needle_state(h.sim, 0) != o->in_the_end) fail_msg("call %d in phase %d: in the end %d", what, phase, trocar_sim_needle_state(h.sim, 0));
            trocar_output out;
            if (o->in_the_end == TROCAR_NEEDLE_RESTING) OK(trocar_sim_take(h.sim, 0, &why));
            work_off(h.sim);
            OK(trocar_sim_tick(h.sim, 0, &base, 1e-3, &out)); /* after any sequence of commands, the needle can be ticked again */
        }
    free(held);
    free(memory);
    host_close(&h);
}

typedef struct {
    trocar_sim *sim;
    atomic_bool stop;
    trocar_status status;
    trocar_error failed;
} worker;

static void *work(void *context) {
    worker *w = context;
    while (!atomic_load(&w->stop)) {
        struct pollfd wake = {.fd = trocar_sim_work_descriptor(w->sim), .events = POLLIN};
        trocar_work work = {.more = 1};
        poll(&wake, 1, 1);
        while (work.more && !atomic_load(&w->stop)) {
            trocar_error error;
            trocar_status status = trocar_sim_work(w->sim, &work, &error);
            if (status != TROCAR_OK && !work.still_held && w->status == TROCAR_OK) w->status = status, w->failed = error;
        }
    }
    return NULL;
}

static bool is_on_its_way(const trocar_sim *sim) {
    trocar_needle_state now = trocar_sim_needle_state(sim, 0);
    return now == TROCAR_NEEDLE_LEAVING || now == TROCAR_NEEDLE_TAKING;
}

/* Makes random calls for two needles while the worker runs. The result must be the one listed for the phase before the call, or for a phase the worker may
   have advanced the needle to in the meantime. */
static void random_calls_beside_a_worker(void **unused) {
    (void)unused;
    enum { ROUNDS = 200, PATIENCE = 120000 }; /* ms */
    static const needle_phase NEXT[PHASES] = {[PHASE_HELD] = PHASE_HELD, [PHASE_LEAVING] = PHASE_RESTING, [PHASE_RESTING] = PHASE_RESTING,
                                              [PHASE_TAKING] = PHASE_TAKEN, [PHASE_TAKEN] = PHASE_TAKEN};
    host h = host_open_with(MESHES "/figure8.yaml", "needles", "2");
    worker w = {.sim = h.sim, .status = TROCAR_OK};
    pthread_t thread;
    unsigned seed = 3;
    trocar_pose base = push_in(h.sim), other = base;
    other.position[0] = -0.01;
    other.position[2] = -0.201;
    OK(trocar_sim_reset(h.sim, 1, &other, &why));
    assert_int_equal(pthread_create(&thread, NULL, work, &w), 0);
    static const call calls[] = {TICK, LEAVE, TAKE, TICK, LEAVE, TAKE, RESET};
    static const needle_phase phases[] = {[TROCAR_NEEDLE_HELD] = PHASE_HELD, [TROCAR_NEEDLE_LEAVING] = PHASE_LEAVING,
                                          [TROCAR_NEEDLE_RESTING] = PHASE_RESTING, [TROCAR_NEEDLE_TAKING] = PHASE_TAKING};
    int made[CALLS][2] = {{0}};
    for (int i = 0; i < ROUNDS; i++) {
        trocar_output out;
        if (other.position[2] < -0.18) other.position[2] += 1e-4;
        trocar_status ticked = trocar_sim_tick(h.sim, 1, &other, 1e-3, &out);
        assert_true(ticked == TROCAR_OK);
        call what = calls[random_below(&seed, sizeof calls / sizeof *calls)];
        needle_phase before = phases[trocar_sim_needle_state(h.sim, 0)];
        bool outside = trocar_view_contacts(trocar_sim_view(h.sim), 0, NULL, 0) == 0;
        why.text[0] = '\0';
        trocar_status status = make(h.sim, what, &base, NULL, 0);
        made[what][status == TROCAR_OK]++;
        bool kept = before == PHASE_LEAVING && status == OUTCOMES[what][PHASE_HELD].status;
        bool nowhere = what == LEAVE && status == TROCAR_BAD_INPUT && outside;
        if (status != OUTCOMES[what][before].status && status != OUTCOMES[what][NEXT[before]].status && !kept && !nowhere)
            fail_msg("call %d in phase %d: %d: %s", what, before, status, why.text);
        if (what == RESET) /* after a reset, inserts the needle again at once */
            for (int t = 0; t < 40; t++) {
                trocar_pose at = base;
                at.position[2] = -0.201 + (base.position[2] + 0.201) * (t + 1) / 40.0;
                trocar_sim_tick(h.sim, 0, &at, 1e-3, &out);
                sched_yield();
            }
        bool waits = random_below(&seed, 2) == 0; /* whether to wait for the worker to finish its task, however long that takes */
        for (int ms = 0; waits && is_on_its_way(h.sim); ms++) {
            assert_true(ms < PATIENCE);
            poll(NULL, 0, 1);
        }
    }
    atomic_store(&w.stop, true);
    pthread_join(thread, NULL);
    if (w.status != TROCAR_OK) fail_msg("%s", w.failed.text);
    print_message("refused and made: tick %d %d, leave %d %d, take %d %d, reset %d %d\n", made[TICK][0], made[TICK][1], made[LEAVE][0], made[LEAVE][1],
                  made[TAKE][0], made[TAKE][1], made[RESET][0], made[RESET][1]);
    assert_true(made[LEAVE][1] > 0 && made[TAKE][1] > 0 && made[RESET][1] > 0);
    host_close(&h);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_event_in_every_phase),
        cmocka_unit_test(the_worker_ends_only_what_still_holds),
        cmocka_unit_test(the_duty_follows_from_phase_and_attachment),
        cmocka_unit_test(requests_are_posted_once_and_their_age_is_known),
        cmocka_unit_test(both_threads_agree_on_who_has_the_needle),
        cmocka_unit_test(every_call_in_every_phase),
        cmocka_unit_test(random_calls_beside_a_worker),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
