#define _GNU_SOURCE
#include "view/implant/dose_thread.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <unistd.h>

#include "base/cache_line.h"
#include "base/triple_buffer.h"
#include "common/eventfd_signal.h"
#include "common/timing.h"
#include "shared/json.h"
#include "view/hand/hole_approach.h"
#include "view/implant/organ_dose.h"
#include "view/stream/section_box.h"

enum {
    ORGANS = 3,
    VOXELS = 1500000,        /* most voxels in the dose grid */
    NICENESS = 15,
};

static const double GRID_SPACING = 1e-3;  /* m */
static const double MARGIN = 0.02;        /* m, how far the dose grid extends beyond the target */
static const double NOTICED = 1e-4;       /* m, smallest displacement after which the dose is recomputed */
static const int64_t PAUSE = 500000000;   /* ns, shortest time between two computations triggered by motion alone */

/* A seed whose dose is in the grid. */
typedef struct {
    trocar_dose_seed rest, now; /* position in the undeformed tissue, which identifies the seed, and position in the grid */
    int32_t id;
} counted_seed;

/* Input of the thread. */
typedef struct {
    int count;
    trocar_dose_seed rest[TROCAR_MAX_SEEDS], now[TROCAR_MAX_SEEDS]; /* in the undeformed and in the deformed tissue */
    double nodal[];          /* m, displacements [nodes][3] */
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
    told_state *done;        /* what was computed last */

    pthread_t thread;
    bool started;
    triple_buffer told;      /* passes a told_state. Not a lock, because this thread has low priority and could hold the lock for a long time */
    int news;                /* eventfd, signalled when there is new input */
    atomic_bool stop;
    section_box result;
};

/* ---- organs and grid ---------------------------------------------------------------------------------------------------- */

static const char *const WORDS[ORGANS][2] = {{"prostate", "gland"}, {"urethra", NULL}, {"rectum", NULL}};

/* Returns the model's first region that is not part of another and whose name contains one of the words; -1 if there is none. */
static int find_organ(const trocar_model *m, const char *const words[2]) {
    for (int r = 0; r < trocar_model_region_count(m); r++)
        for (int w = 0; w < 2 && words[w]; w++)
            if (trocar_model_region_dimension(m, r) == 3 && trocar_model_part_of(m, r) == r && strcasestr(trocar_model_region_name(m, r), words[w])) return r;
    return -1;
}

/* Returns the model's mesh with its organs as regions: the parts of a region get the region's own number. The caller provides the memory, `organ_of_tet`. */
static trocar_mesh mesh_of_organs(const trocar_model *m, int32_t *organ_of_tet) {
    for (int t = 0; t < trocar_model_tet_count(m); t++) organ_of_tet[t] = trocar_model_part_of(m, trocar_model_tet_regions(m)[t]);
    return (trocar_mesh){.node_count = trocar_model_node_count(m), .tet_count = trocar_model_tet_count(m), .nodes = trocar_model_nodes(m),
                         .tets = trocar_model_tets(m), .tet_region = organ_of_tet};
}

/* Returns a dose grid that covers the bounding box of the target or, if there is none, of the whole tissue. */
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

/* Finds the organs, how the target shrinks, and the dose grid. */
static trocar_status prepare_organs(dose_thread *t, const trocar_model *m, trocar_error *why) {
    int32_t *organ_of_tet = malloc((size_t)trocar_model_tet_count(m) * sizeof *organ_of_tet);
    if (!organ_of_tet) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    trocar_mesh mesh = mesh_of_organs(m, organ_of_tet);
    trocar_status status = TROCAR_OK;
    for (int i = 0; status == TROCAR_OK && i < ORGANS; i++) {
        int region = find_organ(m, WORDS[i]);
        if (region < 0) continue;
        organ *o = &t->organs[t->organ_count++];
        status = organ_create(o, m, &mesh, region, why);
        o->is_target = i == 0;
        o->shrinks = i < 2; /* the urethra runs through the gland and shrinks with it */
        if (i == 1 && status == TROCAR_OK && t->organs[0].is_target) organ_limit(o, &t->organs[0]);
    }
    t->shrunk.scale = t->organ_count > 0 && t->organs[0].is_target ? 1.0 / cbrt(t->settings->swelling) : 1.0;
    if (status == TROCAR_OK && t->organ_count > 0) organ_centre(&t->organs[0], t->shrunk.centre);
    t->grid = choose_grid(&mesh, find_organ(m, WORDS[0]));
    free(organ_of_tet);
    return status;
}

static trocar_status prepare(dose_thread *t, const trocar_model *m, trocar_error *why) {
    const char *name = t->settings->source;
    size_t length = strlen(name);
    bool is_file = length > 5 && strcmp(name + length - 5, ".yaml") == 0;
    trocar_status status = is_file ? trocar_dose_source_load(name, &t->source, why) : trocar_dose_source_create(name, &t->source, why);
    if (status == TROCAR_OK) status = prepare_organs(t, m, why);
    if (status != TROCAR_OK) return status;
    t->node_count = trocar_model_node_count(m);
    size_t size = sizeof(told_state) + 3 * (size_t)t->node_count * sizeof(double);
    t->done = calloc(1, size);
    if (!t->done) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    status = triple_buffer_create(&t->told, size, why);
    if (status != TROCAR_OK) return status;
    status = trocar_dose_create(t->source, &t->grid, &t->dose, why);
    if (status != TROCAR_OK) return status;
    size_t count = (size_t)trocar_dose_point_count(t->dose);
    t->values = malloc(count * sizeof *t->values);
    t->levels = malloc(count);
    return t->values && t->levels ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
}

/* ---- seeds -------------------------------------------------------------------------------------------------------------- */

/* Returns how far apart two positions of a seed are (m), as the largest difference in a coordinate. */
static double distance(const trocar_dose_seed *a, const trocar_dose_seed *b) {
    double most = 0.0;
    for (int k = 0; k < 3; k++) most = fmax(most, fabs(a->position[k] - b->position[k]));
    return most;
}

/* Adds a seed to the grid. Skips seeds for which the grid has no room; no server sends that many. */
static void add_seed(dose_thread *t, const trocar_dose_seed *rest, const trocar_dose_seed *now) {
    counted_seed *s = &t->counted[t->count];
    *s = (counted_seed){.rest = *rest, .now = *now};
    trocar_error ignored;
    if (trocar_dose_add(t->dose, now, &s->id, &ignored) == TROCAR_OK) t->count++;
}

static void remove_seed(dose_thread *t, int index) {
    trocar_error ignored;
    trocar_dose_remove(t->dose, t->counted[index].id, &ignored);
    t->counted[index] = t->counted[--t->count];
}

static void move_seed(dose_thread *t, counted_seed *s, const trocar_dose_seed *now) {
    trocar_error ignored;
    if (distance(&s->now, now) > NOTICED && trocar_dose_move(t->dose, s->id, now, &ignored) == TROCAR_OK) s->now = *now;
}

/* Brings the seeds in the grid up to date. A seed is identified by its position in the undeformed tissue. */
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

/* Computes where the seeds are after the target has shrunk; those inside move with it. */
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

/* Encodes the JSON and the grid's levels. The result is empty if out of memory. */
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

static bool has_other_seeds(const told_state *now, const told_state *before) {
    return now->count != before->count || memcmp(now->rest, before->rest, (size_t)now->count * sizeof *now->rest) != 0;
}

/* True if a seed or a node of the mesh has moved by more than NOTICED. False if there are no seeds. */
static bool has_moved(const dose_thread *t, const told_state *now, const told_state *before) {
    if (now->count == 0) return false;
    for (int i = 0; i < now->count; i++)
        if (distance(&now->now[i], &before->now[i]) > NOTICED) return true;
    for (int i = 0; i < 3 * t->node_count; i++)
        if (fabs(now->nodal[i] - before->nodal[i]) > NOTICED) return true;
    return false;
}

/* Waits for new input for up to `patience` ns, or without limit if that is negative. */
static void wait_for_news(const dose_thread *t, int64_t patience) {
    const struct timespec limit = {.tv_sec = patience / 1000000000, .tv_nsec = patience % 1000000000};
    uint64_t count;
    if (ppoll(&(struct pollfd){.fd = t->news, .events = POLLIN}, 1, patience < 0 ? NULL : &limit, NULL) > 0 && read(t->news, &count, sizeof count) < 0) return;
}

/* Computes the dose for each new input. While the tissue is moving, works at most half of the time. */
static void *run(void *context) {
    dose_thread *t = context;
    setpriority(PRIO_PROCESS, (id_t)gettid(), NICENESS); /* on Linux, this affects only the calling thread */
    int64_t rested = 0; /* ns, monotonic; before this time, motion alone does not trigger a computation */
    for (bool first = true; !atomic_load(&t->stop);) {
        const told_state *state = triple_buffer_read(&t->told, NULL);
        int64_t began = monotonic_ns();
        bool other_seeds = first || has_other_seeds(state, t->done), moved = has_moved(t, state, t->done);
        if (!other_seeds && !(moved && began >= rested)) {
            wait_for_news(t, moved ? rested - began : -1);
            continue;
        }
        first = false;
        count_seeds(t, state);
        compute_organs(t, state, other_seeds);
        section_box_put(&t->result, encode(t));
        memcpy(t->done, state, sizeof *state + 3 * (size_t)t->node_count * sizeof *state->nodal);
        int64_t ended = monotonic_ns(), spent = ended - began;
        rested = ended + (spent > PAUSE ? spent : PAUSE);
    }
    return NULL;
}

/* Computes the dose that the planned seeds give to the organs. */
static trocar_status note_plan(dose_thread *t, const plan_table *plan, const double direction[3], trocar_error *why) {
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

trocar_status dose_thread_create(const trocar_model *model, const dose_settings *settings, const plan_table *plan, dose_thread **created, trocar_error *why) {
    dose_thread *t = allocate_on_cache_lines(sizeof *t);
    if (!t) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    t->settings = settings;
    t->news = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    section_box_create(&t->result);
    trocar_status status = t->news >= 0 && t->result.ready >= 0 ? prepare(t, model, why) : fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    if (status == TROCAR_OK && plan) status = note_plan(t, plan, trocar_model_guide(model, find_template(model)).normal, why);
    int error = status == TROCAR_OK ? pthread_create(&t->thread, NULL, run, t) : 0;
    t->started = status == TROCAR_OK && error == 0;
    if (error) status = fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(error));
    if (status == TROCAR_OK) *created = t;
    else dose_thread_free(t);
    return status;
}

void dose_thread_free(dose_thread *t) {
    if (t->started) {
        atomic_store(&t->stop, true);
        eventfd_signal(t->news);
        pthread_join(t->thread, NULL);
    }
    for (int i = 0; i < t->organ_count; i++) organ_free(&t->organs[i]);
    free(t->done);
    triple_buffer_free(&t->told);
    if (t->dose) trocar_dose_free(t->dose);
    if (t->source) trocar_dose_source_free(t->source);
    free(t->values);
    free(t->levels);
    section_box_free(&t->result);
    if (t->news >= 0) close(t->news);
    free(t);
}

static trocar_dose_seed seed_at(const dose_thread *t, const float position[3], const float direction[3]) {
    trocar_dose_seed seed = {.strength = t->settings->strength};
    for (int a = 0; a < 3; a++) seed.position[a] = position[a], seed.direction[a] = direction[a];
    return seed;
}

void dose_thread_tell(dose_thread *t, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation) {
    told_state *state = triple_buffer_slot(&t->told);
    state->count = seeds ? seeds->seed_count : 0;
    for (int i = 0; i < state->count; i++) {
        state->rest[i] = seed_at(t, seeds->rest_position[i], seeds->rest_direction[i]);
        state->now[i] = seed_at(t, seeds->position[i], seeds->direction[i]);
    }
    for (int n = 0; n < t->node_count; n++)
        for (int a = 0; a < 3; a++) state->nodal[3 * n + a] = deformation && n < deformation->node_count ? deformation->displacement[n][a] : 0.0;
    triple_buffer_publish(&t->told);
    eventfd_signal(t->news);
}

int dose_thread_descriptor(const dose_thread *t) { return t->result.ready; }

bool dose_thread_take(dose_thread *t, byte_buffer *section) { return section_box_take(&t->result, section); }
