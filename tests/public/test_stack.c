/* Tests that the ticking thread needs no more stack than trocar.h says. The thread gets exactly that much stack, with a guard page below, and makes every
   call it is allowed to make. The worker, which may need more stack, is the main thread. */
#define _GNU_SOURCE
#include <pthread.h>
#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <trocar.h>
#include <unistd.h>

#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1 /* set under a sanitizer, which makes stack frames larger */
#else
#define SANITIZED 0
#endif

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { PAINT = 0xa5 };

typedef struct {
    trocar_sim *sim;
    trocar_picture *picture;
    trocar_pose base[2];
    sem_t ticked, worked;    /* make the two threads take turns */
    bool ended;
    const char *failed;      /* the first call that was refused; cmocka's assertions work only in the main thread */
    uint32_t events;         /* of all ticks */
    bool rested;
} ticking;

static void expect(ticking *t, bool met, const char *what) {
    if (!met && !t->failed) t->failed = what;
}

/* Lets the worker process all pending requests. */
static void hand_over(ticking *t) {
    sem_post(&t->ticked);
    sem_wait(&t->worked);
}

static void tick(ticking *t, int needle, double forward) {
    trocar_output out;
    t->base[needle].position[2] += forward;
    expect(t, trocar_sim_tick(t->sim, needle, &t->base[needle], 1e-3, &out) == TROCAR_OK, "tick");
    t->events |= out.events;
    hand_over(t);
}

static void look(const trocar_view *view) {
    static trocar_contact contacts[TROCAR_MAX_POINTS];
    static trocar_track_point tracks[TROCAR_MAX_TRACK_POINTS];
    static trocar_seed seeds[TROCAR_MAX_SEEDS];
    static double joints[TROCAR_MAX_JOINTS][3];
    for (int n = 0; n < 2; n++) {
        trocar_view_contacts(view, n, contacts, TROCAR_MAX_POINTS);
        trocar_view_pending_contacts(view, n, contacts, TROCAR_MAX_POINTS);
        trocar_view_centreline(view, n, joints[0], TROCAR_MAX_JOINTS);
        trocar_view_tracks(view, n, tracks, TROCAR_MAX_TRACK_POINTS);
        trocar_view_hole(view, n, 0);
        trocar_view_base(view, n);
        trocar_view_tip_lead(view, n);
        trocar_view_needle_energy(view, n);
        trocar_view_pending_seeds(view, n);
    }
    trocar_view_seeds(view, seeds, TROCAR_MAX_SEEDS);
    trocar_view_probe(view);
    trocar_view_time(view);
}

static void wait_for(ticking *t, trocar_needle_state state) {
    for (int i = 0; i < 50 && trocar_sim_needle_state(t->sim, 0) != state; i++) hand_over(t);
    expect(t, trocar_sim_needle_state(t->sim, 0) == state, "the worker's part");
}

/* Makes invalid calls. Formatting their error messages also needs stack. */
static void be_refused(ticking *t) {
    trocar_error reason;
    const trocar_pose no_pose = {{0}, {0}};
    expect(t, trocar_sim_reset(t->sim, 99, &t->base[0], &reason) == TROCAR_BAD_INPUT, "needle 99");
    expect(t, trocar_sim_reset(t->sim, 0, &no_pose, &reason) == TROCAR_BAD_INPUT, "no pose");
    expect(t, trocar_sim_take(t->sim, 0, &reason) == TROCAR_BAD_INPUT, "a needle that is held");
    expect(t, trocar_sim_drop_seeds(t->sim, 0, 1, 1e-4, &reason) == TROCAR_BAD_INPUT, "seeds that overlap");
    expect(t, trocar_sim_set_probe(t->sim, &t->base[0], &reason) == TROCAR_BAD_INPUT, "a probe");
}

static void *insert(void *context) {
    ticking *t = context;
    int64_t stages[TROCAR_STAGES];
    trocar_sim_set_base_compliance(t->sim, 1, 1e-3);
    for (int n = 0; n < 2; n++) expect(t, trocar_sim_reset(t->sim, n, &t->base[n], NULL) == TROCAR_OK, "reset");
    be_refused(t);
    for (int i = 0; i < 900; i++) {
        tick(t, 0, 1e-4);
        tick(t, 1, 0.8e-4);
        if (i % 100 == 0) {
            trocar_sim_take_picture(t->sim, t->picture);
            look(trocar_sim_view(t->sim));
        }
    }
    expect(t, trocar_sim_drop_seeds(t->sim, 0, 2, 0.0, NULL) == TROCAR_OK, "drop");
    for (int i = 0; i < 300; i++) tick(t, 0, -1e-4);
    expect(t, trocar_sim_undo_seed(t->sim, 0, NULL) == TROCAR_OK, "undo");
    for (int i = 0; i < 50; i++) tick(t, 0, 0.0);
    expect(t, trocar_sim_leave(t->sim, 0, NULL) == TROCAR_OK, "leave");
    wait_for(t, TROCAR_NEEDLE_RESTING);
    t->rested = trocar_sim_needle_state(t->sim, 0) == TROCAR_NEEDLE_RESTING;
    trocar_sim_take_picture(t->sim, t->picture);
    look(trocar_sim_view(t->sim));
    for (int i = 0; i < 100; i++) tick(t, 1, 1e-4);
    expect(t, trocar_sim_take(t->sim, 0, NULL) == TROCAR_OK, "take");
    wait_for(t, TROCAR_NEEDLE_HELD);
    t->base[0] = trocar_view_base(trocar_sim_view(t->sim), 0);
    for (int i = 0; i < 100; i++) tick(t, 0, -1e-4);
    t->base[1].position[0] += 5e-3; /* a sideways jump that costs the solver many passes */
    for (int i = 0; i < 20; i++) tick(t, 1, 0.0);
    trocar_sim_stages(t->sim, stages);
    trocar_sim_waiting(t->sim);
    expect(t, trocar_sim_reset(t->sim, 0, &t->base[1], NULL) == TROCAR_OK, "reset in the tissue");
    for (int i = 0; i < 20; i++) tick(t, 0, 1e-4);
    trocar_output out;
    const trocar_pose far = {{1e200, 0, 0}, {1, 0, 0, 0}}; /* squaring this coordinate overflows, so the insertion restarts */
    expect(t, trocar_sim_tick(t->sim, 1, &far, 1e-3, &out) == TROCAR_NUMERIC && out.events & TROCAR_EVENT_UNSTABLE, "a tick that is not finite");
    t->ended = true;
    sem_post(&t->ticked);
    return NULL;
}

/* Runs `insert` in a thread with `size` bytes of stack while acting as its worker. Returns how many bytes of the stack were used. */
static size_t run_with_stack(ticking *t, size_t size) {
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    unsigned char *memory = mmap(NULL, page + size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    assert_true(memory != MAP_FAILED);
    assert_int_equal(mprotect(memory, page, PROT_NONE), 0);
    memset(memory + page, PAINT, size);
    pthread_attr_t attributes;
    pthread_t thread;
    pthread_attr_init(&attributes);
    assert_int_equal(pthread_attr_setstack(&attributes, memory + page, size), 0);
    assert_int_equal(pthread_create(&thread, &attributes, insert, t), 0);
    pthread_attr_destroy(&attributes);
    for (sem_wait(&t->ticked); !t->ended; sem_wait(&t->ticked)) {
        trocar_work work = {.more = 1};
        while (work.more || work.answered) OK(trocar_sim_work(t->sim, &work, &why));
        sem_post(&t->worked);
    }
    pthread_join(thread, NULL);
    size_t untouched = 0;
    while (untouched < size && memory[page + untouched] == PAINT) untouched++;
    munmap(memory, page + size);
    return size - untouched;
}

static void a_tick_runs_on_the_stated_stack(void **state) {
    (void)state;
    if (SANITIZED) skip();
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(MESHES "/implant.yaml", &scene, &why)); /* has guides, relaxing and stiffening tissue, old tracks and seeds */
    OK(trocar_scene_set(scene, "needles", "2", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    ticking t = {.base = {{{-0.005, 0.005, -0.23}, {1, 0, 0, 0}}, {{0.005, 0.005, -0.23}, {1, 0, 0, 0}}}};
    OK(trocar_sim_create(model, &t.sim, &why));
    OK(trocar_picture_create(model, &t.picture, &why));
    sem_init(&t.ticked, 0, 0);
    sem_init(&t.worked, 0, 0);
    size_t used = run_with_stack(&t, TROCAR_TICK_STACK);
    print_message("%zu of %d bytes\n", used, TROCAR_TICK_STACK);
    if (t.failed) fail_msg("failed: %s", t.failed);
    assert_true(t.events & TROCAR_EVENT_PUNCTURED && t.events & TROCAR_EVENT_ADDED && t.events & TROCAR_EVENT_REMOVED && t.rested);
    assert_true(used > 4096); /* the thread did run on that stack */
    sem_destroy(&t.ticked);
    sem_destroy(&t.worked);
    trocar_picture_free(t.picture);
    trocar_sim_free(t.sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_tick_runs_on_the_stated_stack)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
