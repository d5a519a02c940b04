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

enum {
    ORGANS = 3,
    CURVE = 101,             /* points of a dose-volume histogram */
    VOXELS = 1500000,        /* of the grid, at most */
    NICENESS = 15,
};

static const double ORGAN_SPACING = 1e-3; /* m */
static const double MARGIN = 0.02;        /* m, of the grid around the target */
static const double TOP = 3.0;            /* prescriptions: largest dose of the grid's bytes and of the histograms */

typedef struct {
    const char *name;        /* the scene's */
    bool is_target;
    trocar_structure *structure;
    trocar_dose *dose;
    double *values;          /* Gy; sorted after summarise */
    trocar_dvh_summary planned;
} organ;

/* A seed whose dose is in. */
typedef struct {
    double place[6];         /* position and direction */
    int32_t ids[ORGANS + 1]; /* in each dose; the last one is the grid's */
} counted_seed;

typedef struct {
    int count;
    double places[TROCAR_MAX_SEEDS][6];
} seed_places;

struct dose_thread {
    const dose_settings *settings;
    trocar_dose_source *source;
    organ organs[ORGANS];
    int organ_count;
    trocar_dose_grid grid;
    trocar_dose *dose;
    double *values;
    unsigned char *levels;
    bool has_plan;
    counted_seed counted[TROCAR_MAX_SEEDS];
    int count;

    pthread_t thread;
    bool started;
    int ready;               /* eventfd */
    pthread_mutex_t lock;    /* of what follows */
    pthread_cond_t told;
    seed_places wanted;
    bool has_news, stop, has_result;
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

static trocar_status add_organ(dose_thread *t, const trocar_model *m, const trocar_mesh *mesh, int region, bool is_target, report *why) {
    organ *o = &t->organs[t->organ_count++];
    o->is_target = is_target;
    o->name = trocar_model_region_name(m, region);
    trocar_status status = trocar_structure_from_region(mesh, region, ORGAN_SPACING, &o->structure, why);
    if (status != TROCAR_OK) return status;
    int64_t count = trocar_structure_count(o->structure);
    o->values = malloc((size_t)count * sizeof *o->values);
    if (!o->values) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    return trocar_dose_create_points(t->source, trocar_structure_points(o->structure), count, &o->dose, why);
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
    for (int a = 0; a < 3; a++) voxels *= (high[a] - low[a]) / ORGAN_SPACING + 1.0;
    trocar_dose_grid grid = {.spacing = ORGAN_SPACING * fmax(1.0, cbrt(voxels / VOXELS))};
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
        if (region >= 0) status = add_organ(t, m, &mesh, region, i == 0, why);
    }
    if (status != TROCAR_OK) return status;
    t->grid = choose_grid(&mesh, find_organ(m, WORDS[0]));
    status = trocar_dose_create(t->source, &t->grid, &t->dose, why);
    if (status != TROCAR_OK) return status;
    size_t count = (size_t)trocar_dose_point_count(t->dose);
    t->values = malloc(count * sizeof *t->values);
    t->levels = malloc(count);
    return t->values && t->levels ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
}

/* ---- seeds -------------------------------------------------------------------------------------------------------------- */

static trocar_dose *dose_at(dose_thread *t, int i) { return i < t->organ_count ? t->organs[i].dose : t->dose; }

/* A seed that does not fit, which a server does not send, is left out. */
static void add_seed(dose_thread *t, const double place[6]) {
    counted_seed *s = &t->counted[t->count];
    trocar_dose_seed seed = {.strength = t->settings->strength};
    report ignored;
    memcpy(s->place, place, sizeof s->place);
    memcpy(seed.position, place, sizeof seed.position);
    memcpy(seed.direction, place + 3, sizeof seed.direction);
    for (int i = 0; i <= t->organ_count; i++)
        if (trocar_dose_add(dose_at(t, i), &seed, &s->ids[i], &ignored) != TROCAR_OK) {
            while (--i >= 0) trocar_dose_remove(dose_at(t, i), s->ids[i], &ignored);
            return;
        }
    t->count++;
}

static void remove_seed(dose_thread *t, int index) {
    report ignored;
    for (int i = 0; i <= t->organ_count; i++) trocar_dose_remove(dose_at(t, i), t->counted[index].ids[i], &ignored);
    t->counted[index] = t->counted[--t->count];
}

/* Removes what is no longer there, adds what is new: a place at rest does not change. */
static void count_seeds(dose_thread *t, const seed_places *wanted) {
    bool found[TROCAR_MAX_SEEDS] = {false};
    for (int k = t->count - 1; k >= 0; k--) {
        int i = 0;
        while (i < wanted->count && (found[i] || memcmp(wanted->places[i], t->counted[k].place, sizeof wanted->places[i]) != 0)) i++;
        if (i < wanted->count) found[i] = true;
        else remove_seed(t, k);
    }
    for (int i = 0; i < wanted->count; i++)
        if (!found[i]) add_seed(t, wanted->places[i]);
}

/* ---- results ------------------------------------------------------------------------------------------------------------ */

static trocar_dvh_summary summarise(const dose_thread *t, organ *o) {
    report ignored;
    int64_t count = trocar_structure_count(o->structure);
    trocar_dose_values(o->dose, o->values);
    trocar_dvh_sort(o->values, count, &ignored);
    return trocar_dvh_summarise(o->values, count, trocar_structure_voxel(o->structure), t->settings->prescription);
}

static void write_figures(json *j, const char *name, const trocar_dvh_summary *s) {
    json_open(j, name, '{');
    json_number(j, "d90", s->d90);
    json_number(j, "d10", s->d10);
    json_number(j, "d30", s->d30);
    json_number(j, "v100", s->v100);
    json_number(j, "v150", s->v150);
    json_number(j, "v200", s->v200);
    json_number(j, "v100cm3", s->v100_cm3);
    json_close(j, '}');
}

static void write_organ(const dose_thread *t, json *j, organ *o) {
    trocar_dvh_summary s = summarise(t, o);
    double curve[CURVE];
    for (int i = 0; i < CURVE; i++)
        curve[i] = trocar_dvh_volume(o->values, trocar_structure_count(o->structure), TOP * t->settings->prescription * i / (CURVE - 1));
    json_open(j, NULL, '{');
    json_text(j, "name", o->name);
    json_bool(j, "target", o->is_target);
    json_number(j, "volume", s.volume_cm3);
    write_figures(j, "now", &s);
    if (t->has_plan) write_figures(j, "planned", &o->planned);
    json_numbers(j, "curve", curve, CURVE);
    json_close(j, '}');
}

static void write_dose(dose_thread *t, FILE *out) {
    json j = {.out = out};
    double counts[3] = {t->grid.counts[0], t->grid.counts[1], t->grid.counts[2]};
    json_open(&j, NULL, '{');
    json_text(&j, "source", trocar_dose_source_get(t->source).name);
    json_number(&j, "strength", t->settings->strength);
    json_number(&j, "prescription", t->settings->prescription);
    json_number(&j, "top", TOP);
    json_integer(&j, "seeds", t->count);
    json_numbers(&j, "origin", t->grid.origin, 3);
    json_number(&j, "spacing", t->grid.spacing);
    json_numbers(&j, "counts", counts, 3);
    json_open(&j, "organs", '[');
    for (int i = 0; i < t->organ_count; i++) write_organ(t, &j, &t->organs[i]);
    json_close(&j, ']');
    json_close(&j, '}');
}

static void find_levels(dose_thread *t) {
    int64_t count = trocar_dose_point_count(t->dose);
    double scale = UINT8_MAX / (TOP * t->settings->prescription);
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

/* False: stop. */
static bool wait_for_seeds(dose_thread *t, seed_places *wanted) {
    pthread_mutex_lock(&t->lock);
    while (!t->has_news && !t->stop) pthread_cond_wait(&t->told, &t->lock);
    bool stop = t->stop;
    t->has_news = false;
    *wanted = t->wanted;
    pthread_mutex_unlock(&t->lock);
    return !stop;
}

static void *run(void *context) {
    dose_thread *t = context;
    setpriority(PRIO_PROCESS, (id_t)gettid(), NICENESS); /* of this thread alone */
    static _Thread_local seed_places wanted;
    while (wait_for_seeds(t, &wanted)) {
        count_seeds(t, &wanted);
        byte_buffer result = encode(t);
        pthread_mutex_lock(&t->lock);
        bytes_free(&t->result);
        t->result = result;
        t->has_result = result.length > 0;
        pthread_mutex_unlock(&t->lock);
        wake(t->ready);
    }
    return NULL;
}

/* The plan's dose, before there are any seeds. */
static void note_plan(dose_thread *t, const plan_table *plan, const double direction[3]) {
    static const seed_places none = {.count = 0};
    for (int i = 0; i < plan->count; i++) {
        const double *x = plan->seeds[i].position;
        add_seed(t, (double[6]){x[0], x[1], x[2], direction[0], direction[1], direction[2]});
    }
    for (int i = 0; i < t->organ_count; i++) t->organs[i].planned = summarise(t, &t->organs[i]);
    t->has_plan = true;
    count_seeds(t, &none);
}

trocar_status dose_thread_create(const trocar_model *model, const dose_settings *settings, const plan_table *plan, dose_thread **created, report *why) {
    dose_thread *t = calloc(1, sizeof *t);
    if (!t) return fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
    t->settings = settings;
    t->has_news = true; /* computes the dose of no seeds */
    pthread_mutex_init(&t->lock, NULL);
    pthread_cond_init(&t->told, NULL);
    t->ready = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    trocar_status status = t->ready >= 0 ? prepare(t, model, why) : fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    if (status == TROCAR_OK && plan) note_plan(t, plan, trocar_model_guide(model, find_template(model)).normal);
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
    for (int i = 0; i < t->organ_count; i++) {
        organ *o = &t->organs[i];
        if (o->dose) trocar_dose_free(o->dose);
        if (o->structure) trocar_structure_free(o->structure);
        free(o->values);
    }
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

static seed_places places_of(const trocar_seeds_t *seeds) {
    seed_places places = {.count = seeds ? seeds->seed_count : 0};
    for (int i = 0; i < places.count; i++)
        for (int a = 0; a < 3; a++) {
            places.places[i][a] = seeds->rest_position[i][a];
            places.places[i][3 + a] = seeds->rest_direction[i][a];
        }
    return places;
}

void dose_thread_tell(dose_thread *t, const trocar_seeds_t *seeds) {
    seed_places wanted = places_of(seeds);
    pthread_mutex_lock(&t->lock);
    size_t size = (size_t)wanted.count * sizeof *wanted.places;
    bool same = wanted.count == t->wanted.count && memcmp(wanted.places, t->wanted.places, size) == 0;
    if (!same) {
        t->wanted = wanted;
        t->has_news = true;
        pthread_cond_signal(&t->told);
    }
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
