#define _GNU_SOURCE
#include "dose_thread.h"

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <unistd.h>

#include "exchange.h"
#include "hole_approach.h"
#include "json.h"
#include "organ_dose.h"
#include "timing.h"

enum {
    ORGANS = 3,
    VOXELS = 1500000,        /* of the grid, at most */
    NICENESS = 15,
};

static const double GRID_SPACING = 1e-3;  /* m */
static const double MARGIN = 0.02;        /* m, of the grid around the target */
static const double NOTICED = 1e-4;       /* m, by which something has to move for the dose to be computed anew */
static const int64_t PAUSE = 500000000;   /* ns, least time between computations because of motion alone */

/* A seed whose dose is in the grid. */
typedef struct {
    trocar_dose_seed rest, now; /* where it lies at rest, which does not change; and where the grid has it */
    int32_t id;
} counted_seed;

/* What the thread is told. */
typedef struct {
    int count;
    trocar_dose_seed rest[TROCAR_MAX_SEEDS], now[TROCAR_MAX_SEEDS]; /* in the tissue at rest, and as it is displaced */
    double *nodal;           /* displacements [nodes][3], m */
} told_state;

struct dose_thread {
    const dose_settings *settings;
    trocar_dose_source *source;
    organ organs[ORGANS];
    int organ_count, node_count;
    shrinkage shrunk;        /* of the target, organs[0], if there is one */
    trocar_dose_grid grid;
    trocar_dose *dose;
    double *values;
    unsigned char *levels;
    counted_seed counted[TROCAR_MAX_SEEDS];
    int count;
    told_state doing;        /* the thread's copy */

    pthread_t thread;
    bool started;
    int ready;               /* eventfd */
    pthread_mutex_t lock;    /* of what follows */
    pthread_cond_t told;
    told_state wanted, newest; /* the state to compute next, or computed last; and the newest one */
    bool has_seeds, has_motion, stop, has_result; /* other seeds; all has moved */
    byte_buffer result;
};

/* ---- organs and grid ---------------------------------------------------------------------------------------------------- */

static const char *const WORDS[ORGANS][2] = {{"prostate", "gland"}, {"urethra", NULL}, {"rectum", NULL}};

/* The model's first region of which the name contains one of the words, -1: none. */
static int find_organ(const trocar_model *m, const char *const words[2]) {
    for (int r = 0; r < trocar_model_region_count(m); r++)
        for (int w = 0; w < 2 && words[w]; w++)
            if (trocar_model_region_dimension(m, r) == 3 && strcasestr(trocar_model_region_name(m, r), words[w])) return r;
    return -1;
}

/* A box around the target, or around the whole tissue if there is none. */
static trocar_dose_grid choose_grid(const trocar_mesh *mesh, int target) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, voxels = 1.0;
    for (int i = 0; i < 4 * mesh->tet_count; i++) {
        if (target >= 0 && mesh->tet_region[i / 4] != target) continue;
        for (int a = 0; a < 3; a++) {
            double x = mesh->nodes[3 * mesh->tets[i] + a];
            low[a] = fmin(low[a], x - MARGIN);
            high[a] = fmax(high[a], x + MARGIN);
        }
    }
    for (int a = 0; a < 3; a++) voxels *= (high[a] - low[a]) / GRID_SPACING + 1.0;
    trocar_dose_grid grid = {.spacing = GRID_SPACING * fmax(1.0, cbrt(voxels / VOXELS))};
    for (int a = 0; a < 3; a++) {
        grid.origin[a] = low[a];
        grid.counts[a] = (int32_t)((high[a] - low[a]) / grid.spacing) + 1;
    }
    return grid;
}

static trocar_status prepare(dose_thread *t, const trocar_model *m, report *why) {
    const char *name = t->settings->source;
    size_t length = strlen(name);
    bool is_file = length > 5 && strcmp(name + length - 5, ".yaml") == 0;
    trocar_status status = is_file ? trocar_dose_source_load(name, &t->source, why) : trocar_dose_source_create(name, &t->source, why);
    trocar_mesh mesh = {.node_count = trocar_model_node_count(m), .tet_count = trocar_model_tet_count(m), .nodes = trocar_model_nodes(m),
                        .tets = trocar_model_tets(m), .tet_region = trocar_model_tet_regions(m)};
    for (int i = 0; status == TROCAR_OK && i < ORGANS; i++) {
        int region = find_organ(m, WORDS[i]);
        if (region < 0) continue;
        organ *o = &t->organs[t->organ_count++];
        status = organ_create(o, m, &mesh, region, why);
        o->is_target = i == 0;
        o->shrinks = i < 2; /* the urethra runs through the gland */
    }
    if (status != TROCAR_OK) return status;
    t->shrunk.scale = t->organ_count > 0 && t->organs[0].is_target ? 1.0 / cbrt(t->settings->swelling) : 1.0;
    if (t->organ_count > 0) organ_centre(&t->organs[0], t->shrunk.centre);
    t->node_count = mesh.node_count;
    size_t nodal = 3 * (size_t)mesh.node_count;
    t->doing.nodal = calloc(nodal, sizeof *t->doing.nodal);
    t->wanted.nodal = calloc(nodal, sizeof *t->wanted.nodal);
    t->newest.nodal = calloc(nodal, sizeof *t->newest.nodal);
    if (!t->doing.nodal || !t->wanted.nodal || !t->newest.nodal) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    t->grid = choose_grid(&mesh, find_organ(m, WORDS[0]));
    status = trocar_dose_create(t->source, &t->grid, &t->dose, why);
    if (status != TROCAR_OK) return status;
    size_t count = (size_t)trocar_dose_point_count(t->dose);
    t->values = malloc(count * sizeof *t->values);
    t->levels = malloc(count);
    return t->values && t->levels ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
}

/* ---- seeds -------------------------------------------------------------------------------------------------------------- */

/* m, how far a seed is from where it was. */
static double distance(const trocar_dose_seed *a, const trocar_dose_seed *b) {
    double most = 0.0;
    for (int k = 0; k < 3; k++) most = fmax(most, fabs(a->position[k] - b->position[k]));
    return most;
}

/* A seed that does not fit, which a server does not send, is left out. */
static void add_seed(dose_thread *t, const trocar_dose_seed *rest, const trocar_dose_seed *now) {
    counted_seed *s = &t->counted[t->count];
    *s = (counted_seed){.rest = *rest, .now = *now};
    report ignored;
    if (trocar_dose_add(t->dose, now, &s->id, &ignored) == TROCAR_OK) t->count++;
}

static void remove_seed(dose_thread *t, int index) {
    report ignored;
    trocar_dose_remove(t->dose, t->counted[index].id, &ignored);
    t->counted[index] = t->counted[--t->count];
}

static void move_seed(dose_thread *t, counted_seed *s, const trocar_dose_seed *now) {
    report ignored;
    if (distance(&s->now, now) > NOTICED && trocar_dose_move(t->dose, s->id, now, &ignored) == TROCAR_OK) s->now = *now;
}

/* Brings the grid up to date: a seed is known by its place at rest. */
static void count_seeds(dose_thread *t, const told_state *state) {
    bool found[TROCAR_MAX_SEEDS] = {false};
    for (int k = t->count - 1; k >= 0; k--) {
        int i = 0;
        while (i < state->count && (found[i] || memcmp(&state->rest[i], &t->counted[k].rest, sizeof state->rest[i]) != 0)) i++;
        if (i == state->count) {
            remove_seed(t, k);
            continue;
        }
        found[i] = true;
        move_seed(t, &t->counted[k], &state->now[i]);
    }
    for (int i = 0; i < state->count; i++)
        if (!found[i]) add_seed(t, &state->rest[i], &state->now[i]);
}

/* The seeds of the target follow it when it shrinks. */
static void shrink_seeds(const dose_thread *t, const told_state *state, trocar_dose_seed *shrunk) {
    for (int i = 0; i < state->count; i++) {
        shrunk[i] = state->rest[i];
        if (t->shrunk.scale < 1.0 && organ_contains(&t->organs[0], state->rest[i].position)) shrink(&t->shrunk, state->rest[i].position, shrunk[i].position);
    }
}

static void compute_organs(dose_thread *t, const told_state *state, bool other_seeds) {
    static _Thread_local trocar_dose_seed shrunk[TROCAR_MAX_SEEDS];
    double prescription = t->settings->prescription;
    if (other_seeds) shrink_seeds(t, state, shrunk);
    for (organ *o = t->organs; o < t->organs + t->organ_count; o++) {
        organ_compute(o, DOSE_NOW, t->source, state->now, state->count, prescription, state->nodal, &t->shrunk);
        if (!other_seeds) continue;
        organ_compute(o, DOSE_NEEDLES_OUT, t->source, state->rest, state->count, prescription, NULL, &t->shrunk);
        organ_compute(o, DOSE_SWELLING_GONE, t->source, shrunk, state->count, prescription, NULL, &t->shrunk);
    }
}

/* ---- results ------------------------------------------------------------------------------------------------------------ */

static void write_result(json *j, const char *name, const organ_result *r) {
    const trocar_dvh_summary *s = &r->summary;
    json_open(j, name, '{');
    json_number(j, "d90", s->d90);
    json_number(j, "d10", s->d10);
    json_number(j, "d30", s->d30);
    json_number(j, "v100", s->v100);
    json_number(j, "v150", s->v150);
    json_number(j, "v200", s->v200);
    json_number(j, "v100cm3", s->v100_cm3);
    json_numbers(j, "curve", r->curve, DVH_POINTS);
    json_close(j, '}');
}

static void write_organ(json *j, const organ *o) {
    static const char *const names[DOSE_STATES] = {"planned", "now", "out", "later"};
    json_open(j, NULL, '{');
    json_text(j, "name", o->name);
    json_bool(j, "target", o->is_target);
    json_number(j, "volume", o->results[DOSE_NOW].summary.volume_cm3);
    for (int state = 0; state < DOSE_STATES; state++)
        if (o->results[state].known) write_result(j, names[state], &o->results[state]);
    json_close(j, '}');
}

static void write_dose(dose_thread *t, FILE *out) {
    json j = {.out = out};
    double counts[3] = {t->grid.counts[0], t->grid.counts[1], t->grid.counts[2]};
    json_open(&j, NULL, '{');
    json_text(&j, "source", trocar_dose_source_get(t->source).name);
    json_number(&j, "strength", t->settings->strength);
    json_number(&j, "prescription", t->settings->prescription);
    json_number(&j, "top", DVH_TOP);
    json_number(&j, "swelling", t->settings->swelling);
    json_integer(&j, "seeds", t->count);
    json_numbers(&j, "origin", t->grid.origin, 3);
    json_number(&j, "spacing", t->grid.spacing);
    json_numbers(&j, "counts", counts, 3);
    json_open(&j, "organs", '[');
    for (int i = 0; i < t->organ_count; i++) write_organ(&j, &t->organs[i]);
    json_close(&j, ']');
    json_close(&j, '}');
}

static void find_levels(dose_thread *t) {
    int64_t count = trocar_dose_point_count(t->dose);
    double scale = UINT8_MAX / (DVH_TOP * t->settings->prescription);
    trocar_dose_values(t->dose, t->values);
    for (int64_t i = 0; i < count; i++) t->levels[i] = (unsigned char)fmin(UINT8_MAX, 0.5 + scale * t->values[i]);
}

/* JSON and the grid's levels; empty if memory runs out. */
static byte_buffer encode(dose_thread *t) {
    byte_buffer section = {0};
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return section;
    write_dose(t, out);
    fclose(out);
    find_levels(t);
    encode_json_and_bytes(&section, SECTION_DOSE, text, length, t->levels, (size_t)trocar_dose_point_count(t->dose));
    free(text);
    if (section.failed) bytes_free(&section);
    return section;
}

/* ---- thread ------------------------------------------------------------------------------------------------------------- */

static void copy_state(const dose_thread *t, told_state *to, const told_state *from) {
    to->count = from->count;
    memcpy(to->rest, from->rest, (size_t)from->count * sizeof *to->rest);
    memcpy(to->now, from->now, (size_t)from->count * sizeof *to->now);
    memcpy(to->nodal, from->nodal, 3 * (size_t)t->node_count * sizeof *to->nodal);
}

/* Waits for other seeds, or for motion after the time `rested` (ns, monotonic). False: stop. */
static bool wait_for_news(dose_thread *t, int64_t rested, bool *other_seeds) {
    const struct timespec until = {.tv_sec = rested / 1000000000, .tv_nsec = rested % 1000000000};
    pthread_mutex_lock(&t->lock);
    while (!t->stop && !t->has_seeds && !(t->has_motion && monotonic_ns() >= rested))
        if (t->has_motion) pthread_cond_timedwait(&t->told, &t->lock, &until);
        else pthread_cond_wait(&t->told, &t->lock);
    bool stop = t->stop;
    *other_seeds = t->has_seeds;
    t->has_seeds = t->has_motion = false;
    copy_state(t, &t->doing, &t->newest);
    copy_state(t, &t->wanted, &t->newest);
    pthread_mutex_unlock(&t->lock);
    return !stop;
}

/* While the tissue moves, at most half of the time is spent here. */
static void *run(void *context) {
    dose_thread *t = context;
    setpriority(PRIO_PROCESS, (id_t)gettid(), NICENESS); /* of this thread alone */
    bool other_seeds;
    for (int64_t rested = 0; wait_for_news(t, rested, &other_seeds);) {
        int64_t began = monotonic_ns();
        count_seeds(t, &t->doing);
        compute_organs(t, &t->doing, other_seeds);
        byte_buffer result = encode(t);
        pthread_mutex_lock(&t->lock);
        bytes_free(&t->result);
        t->result = result;
        t->has_result = result.length > 0;
        pthread_mutex_unlock(&t->lock);
        wake(t->ready);
        int64_t ended = monotonic_ns(), spent = ended - began;
        rested = ended + (spent > PAUSE ? spent : PAUSE);
    }
    return NULL;
}

/* The plan's dose in the organs. */
static trocar_status note_plan(dose_thread *t, const plan_table *plan, const double direction[3], report *why) {
    trocar_dose_seed *seeds = calloc((size_t)plan->count + 1, sizeof *seeds);
    if (!seeds) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    for (int i = 0; i < plan->count; i++) {
        seeds[i].strength = t->settings->strength;
        memcpy(seeds[i].position, plan->seeds[i].position, sizeof seeds[i].position);
        memcpy(seeds[i].direction, direction, sizeof seeds[i].direction);
    }
    for (int i = 0; i < t->organ_count; i++)
        organ_compute(&t->organs[i], DOSE_PLANNED, t->source, seeds, plan->count, t->settings->prescription, NULL, &t->shrunk);
    free(seeds);
    return TROCAR_OK;
}

/* A condition whose timed waits are by the monotonic clock. */
static void init_condition(pthread_cond_t *condition) {
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(condition, &attributes);
    pthread_condattr_destroy(&attributes);
}

trocar_status dose_thread_create(const trocar_model *model, const dose_settings *settings, const plan_table *plan, dose_thread **created, report *why) {
    dose_thread *t = calloc(1, sizeof *t);
    if (!t) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    t->settings = settings;
    t->has_seeds = true; /* computes the dose of no seeds */
    pthread_mutex_init(&t->lock, NULL);
    init_condition(&t->told);
    t->ready = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    trocar_status status = t->ready >= 0 ? prepare(t, model, why) : fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    if (status == TROCAR_OK && plan) status = note_plan(t, plan, trocar_model_guide(model, find_template(model)).normal, why);
    if (status == TROCAR_OK) t->started = pthread_create(&t->thread, NULL, run, t) == 0;
    if (status == TROCAR_OK && !t->started) status = fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(errno));
    if (status == TROCAR_OK) *created = t;
    else dose_thread_free(t);
    return status;
}

void dose_thread_free(dose_thread *t) {
    if (t->started) {
        pthread_mutex_lock(&t->lock);
        t->stop = true;
        pthread_cond_signal(&t->told);
        pthread_mutex_unlock(&t->lock);
        pthread_join(t->thread, NULL);
    }
    for (int i = 0; i < t->organ_count; i++) organ_free(&t->organs[i]);
    free(t->doing.nodal);
    free(t->wanted.nodal);
    free(t->newest.nodal);
    if (t->dose) trocar_dose_free(t->dose);
    if (t->source) trocar_dose_source_free(t->source);
    free(t->values);
    free(t->levels);
    bytes_free(&t->result);
    if (t->ready >= 0) close(t->ready);
    pthread_cond_destroy(&t->told);
    pthread_mutex_destroy(&t->lock);
    free(t);
}

static trocar_dose_seed seed_at(const dose_thread *t, const float position[3], const float direction[3]) {
    trocar_dose_seed seed = {.strength = t->settings->strength};
    for (int a = 0; a < 3; a++) seed.position[a] = position[a], seed.direction[a] = direction[a];
    return seed;
}

static void note_newest(dose_thread *t, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation) {
    t->newest.count = seeds ? seeds->seed_count : 0;
    for (int i = 0; i < t->newest.count; i++) {
        t->newest.rest[i] = seed_at(t, seeds->rest_position[i], seeds->rest_direction[i]);
        t->newest.now[i] = seed_at(t, seeds->position[i], seeds->direction[i]);
    }
    for (int n = 0; n < t->node_count; n++)
        for (int a = 0; a < 3; a++) t->newest.nodal[3 * n + a] = deformation && n < deformation->node_count ? deformation->displacement[n][a] : 0.0;
}

/* Whether something that gets a dose has moved since the last computation. */
static bool has_moved(const dose_thread *t) {
    for (int i = 0; i < t->newest.count; i++)
        if (distance(&t->newest.now[i], &t->wanted.now[i]) > NOTICED) return true;
    for (int i = 0; t->newest.count > 0 && i < 3 * t->node_count; i++)
        if (fabs(t->newest.nodal[i] - t->wanted.nodal[i]) > NOTICED) return true;
    return false;
}

void dose_thread_tell(dose_thread *t, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation) {
    pthread_mutex_lock(&t->lock);
    note_newest(t, seeds, deformation);
    size_t size = (size_t)t->newest.count * sizeof *t->newest.rest;
    bool same = t->newest.count == t->wanted.count && memcmp(t->newest.rest, t->wanted.rest, size) == 0;
    t->has_seeds |= !same;
    t->has_motion |= same && has_moved(t);
    if (t->has_seeds || t->has_motion) pthread_cond_signal(&t->told);
    pthread_mutex_unlock(&t->lock);
}

int dose_thread_descriptor(const dose_thread *t) { return t->ready; }

bool dose_thread_take(dose_thread *t, byte_buffer *section) {
    uint64_t count;
    if (read(t->ready, &count, sizeof count) < 0) return false;
    pthread_mutex_lock(&t->lock);
    bool has = t->has_result;
    if (has) {
        bytes_free(section);
        *section = t->result;
        t->result = (byte_buffer){0};
        t->has_result = false;
    }
    pthread_mutex_unlock(&t->lock);
    return has;
}
