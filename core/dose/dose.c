/* Implements the doses and dose rates in trocar/dose.h, on a grid or at arbitrary points. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "base/flush_denormals.h"
#include "dose/tg43.h"

static const double FARTHEST = 1000.0; /* m, limit on coordinates and on the spacing */
static const double MAX_STRENGTH = 1000.0; /* U, maximum air-kerma strength of a seed */
static const int64_t MAX_POINTS_OF_DOSE = INT64_C(1) << 28;

typedef struct {
    int32_t id;
    trocar_dose_seed given;
} listed_seed;

/* With at most 4095 seeds of at most 2^51 quanta each, sums stay below 2^63. */
struct trocar_dose {
    const trocar_dose_source *source;
    int64_t count;           /* number of points */
    trocar_dose_grid grid;   /* used if `points` is NULL */
    double *points;          /* [count][3], m, rest positions; NULL for a grid */
    double *moved;           /* [count][3], m, displaced positions; NULL before the first displacement */
    bool displaced;          /* true if the points are at `moved` instead of their rest positions */
    int64_t *quanta;         /* [count], dose in multiples of TROCAR_DOSE_QUANTUM */
    listed_seed *seeds;      /* array of `room` entries, of which seed_count are used */
    int seed_count, room;
    int32_t next_id;
};

/* ---- input --------------------------------------------------------------------------------------------------------------------- */

static bool is_near(const double p[3]) { return fabs(p[0]) <= FARTHEST && fabs(p[1]) <= FARTHEST && fabs(p[2]) <= FARTHEST; }

static trocar_status check_seed(const trocar_dose_seed *seed, trocar_error *why) {
    const double *d = seed->direction;
    if (!is_near(seed->position))
        return fail(why, TROCAR_BAD_INPUT, "a seed at (%g, %g, %g): expected finite numbers, at most 1000 m", seed->position[0], seed->position[1], seed->position[2]);
    double length = v3_norm(v3(d[0], d[1], d[2]));
    if (!(length > 1e-150 && length < 1e150))
        return fail(why, TROCAR_BAD_INPUT, "a seed along (%g, %g, %g): expected a direction: three finite numbers, not all 0", d[0], d[1], d[2]);
    if (!(seed->strength > 0.0 && seed->strength <= MAX_STRENGTH))
        return fail(why, TROCAR_BAD_INPUT, "a seed of %g U: expected an air-kerma strength above 0 and at most %g U", seed->strength, MAX_STRENGTH);
    return TROCAR_OK;
}

static trocar_status check_points(const double *points, int64_t count, trocar_error *why) {
    if (count < 1 || count > MAX_POINTS_OF_DOSE) return fail(why, TROCAR_BAD_INPUT, "%lld points: expected 1 to 2^28", (long long)count);
    for (int64_t i = 0; i < count; i++)
        if (!is_near(points + 3 * i))
            return fail(why, TROCAR_BAD_INPUT, "point %lld is at (%g, %g, %g): expected finite numbers, at most 1000 m", (long long)i, points[3 * i],
                        points[3 * i + 1], points[3 * i + 2]);
    return TROCAR_OK;
}

static trocar_status check_grid(const trocar_dose_grid *g, trocar_error *why) {
    double voxels = 1.0;
    for (int k = 0; k < 3; k++) {
        if (g->counts[k] < 1) return fail(why, TROCAR_BAD_INPUT, "a grid of %d x %d x %d voxels: expected at least 1 in each direction", g->counts[0], g->counts[1], g->counts[2]);
        voxels *= g->counts[k];
    }
    if (voxels > (double)MAX_POINTS_OF_DOSE)
        return fail(why, TROCAR_BAD_INPUT, "a grid of %d x %d x %d voxels: at most 2^28 in total; make the spacing larger", g->counts[0], g->counts[1], g->counts[2]);
    if (!(g->spacing > 0.0 && g->spacing <= FARTHEST)) return fail(why, TROCAR_BAD_INPUT, "a grid with a spacing of %g m: expected a number above 0, at most 1000", g->spacing);
    double last[3];
    for (int k = 0; k < 3; k++) last[k] = g->origin[k] + g->spacing * (g->counts[k] - 1);
    if (!is_near(g->origin) || !is_near(last))
        return fail(why, TROCAR_BAD_INPUT, "a grid from (%g, %g, %g) to (%g, %g, %g): expected finite numbers, at most 1000 m", g->origin[0], g->origin[1], g->origin[2],
                    last[0], last[1], last[2]);
    return TROCAR_OK;
}

/* ---- points --------------------------------------------------------------------------------------------------------------------- */

typedef struct { double x[TG43_BLOCK], y[TG43_BLOCK], z[TG43_BLOCK]; } point_block;

static void take_listed(const double *points, int count, point_block *block) {
    for (int i = 0; i < count; i++) {
        block->x[i] = points[3 * i];
        block->y[i] = points[3 * i + 1];
        block->z[i] = points[3 * i + 2];
    }
}

static void take_voxels(const trocar_dose_grid *g, int64_t first, int count, point_block *block) {
    int64_t column = first / g->counts[2];
    int k = (int)(first % g->counts[2]), j = (int)(column % g->counts[1]), i = (int)(column / g->counts[1]);
    for (int n = 0; n < count; n++) {
        block->x[n] = g->origin[0] + g->spacing * i;
        block->y[n] = g->origin[1] + g->spacing * j;
        block->z[n] = g->origin[2] + g->spacing * k;
        if (++k < g->counts[2]) continue;
        k = 0;
        if (++j < g->counts[1]) continue;
        j = 0;
        i++;
    }
}

static void take_block(const trocar_dose *d, int64_t first, int count, point_block *block) {
    const double *points = d->displaced ? d->moved : d->points;
    if (points) take_listed(points + 3 * first, count, block);
    else take_voxels(&d->grid, first, count, block);
}

/* ---- sums ------------------------------------------------------------------------------------------------------------------------ */

static seed_place place_of(const trocar_dose_seed *seed) {
    const double *p = seed->position, *d = seed->direction;
    return (seed_place){v3(p[0], p[1], p[2]), v3_unit(v3(d[0], d[1], d[2]))};
}

static int block_size(int64_t first, int64_t count) { return count - first < TG43_BLOCK ? (int)(count - first) : TG43_BLOCK; }

/* Adds a seed's dose at all points (`sign` 1), or subtracts exactly the same numbers again (`sign` -1). */
static void accumulate(trocar_dose *d, const trocar_dose_seed *seed, int64_t sign) {
    const double round = 0x1.8p52; /* adding this to a number below 2^51 rounds it to an integer, found in the last bits of the sum */
    int64_t round_bits;
    memcpy(&round_bits, &round, sizeof round_bits);
    seed_place place = place_of(seed);
    double quanta_per_rate = seed->strength * trocar_dose_hours(d->source, INFINITY) / TROCAR_DOSE_QUANTUM;
    const double most = TROCAR_MAX_SEED_DOSE / TROCAR_DOSE_QUANTUM;
    point_block block;
    double rate[TG43_BLOCK];
    for (int64_t first = 0; first < d->count; first += TG43_BLOCK) {
        int count = block_size(first, d->count);
        take_block(d, first, count, &block);
        tg43_rates(d->source, &place, block.x, block.y, block.z, count, rate);
        int64_t *quanta = d->quanta + first;
        for (int i = 0; i < count; i++) {
            double q = quanta_per_rate * rate[i], rounded = (q < most ? q : most) + round;
            int64_t bits;
            memcpy(&bits, &rounded, sizeof bits);
            quanta[i] += sign * (bits - round_bits);
        }
    }
}

trocar_status trocar_dose_rates(const trocar_dose_source *source, const trocar_dose_seed *seeds, int seed_count, const double *points, int64_t count,
                                double *rates, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_status status = check_points(points, count, why);
    for (int i = 0; i < seed_count && status == TROCAR_OK; i++) status = check_seed(&seeds[i], why);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    point_block block;
    double rate[TG43_BLOCK];
    for (int64_t first = 0; first < count; first += TG43_BLOCK) {
        int size = block_size(first, count);
        take_listed(points + 3 * first, size, &block);
        memset(rates + first, 0, (size_t)size * sizeof *rates);
        for (int k = 0; k < seed_count; k++) {
            seed_place place = place_of(&seeds[k]);
            tg43_rates(source, &place, block.x, block.y, block.z, size, rate);
            for (int i = 0; i < size; i++) rates[first + i] += seeds[k].strength * rate[i];
        }
    }
    restore_floating_mode(before);
    return TROCAR_OK;
}

/* ---- the object -------------------------------------------------------------------------------------------------------------------- */

static trocar_status create(const trocar_dose_source *source, int64_t count, const double *points, trocar_dose **created, trocar_error *why) {
    trocar_dose *d = calloc(1, sizeof *d);
    if (d) d->quanta = calloc((size_t)count, sizeof *d->quanta);
    if (d && points) d->points = malloc(3 * (size_t)count * sizeof *points);
    if (!d || !d->quanta || (points && !d->points)) {
        trocar_dose_free(d);
        return fail(why, TROCAR_NO_MEMORY, "no memory for the dose at %lld points", (long long)count);
    }
    if (points) memcpy(d->points, points, 3 * (size_t)count * sizeof *points);
    d->source = source;
    d->count = count;
    *created = d;
    return TROCAR_OK;
}

trocar_status trocar_dose_create(const trocar_dose_source *source, const trocar_dose_grid *grid, trocar_dose **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    trocar_status status = check_grid(grid, why);
    if (status == TROCAR_OK) status = create(source, (int64_t)grid->counts[0] * grid->counts[1] * grid->counts[2], NULL, created, why);
    if (status == TROCAR_OK) (*created)->grid = *grid;
    return status;
}

trocar_status trocar_dose_create_points(const trocar_dose_source *source, const double *points, int64_t count, trocar_dose **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    *created = NULL;
    trocar_status status = check_points(points, count, why);
    return status == TROCAR_OK ? create(source, count, points, created, why) : status;
}

void trocar_dose_free(trocar_dose *dose) {
    if (!dose) return;
    free(dose->points);
    free(dose->moved);
    free(dose->quanta);
    free(dose->seeds);
    free(dose);
}

static trocar_status make_room(trocar_dose *d, trocar_error *why) {
    if (d->seed_count == TROCAR_MAX_DOSE_SEEDS) return fail(why, TROCAR_BAD_INPUT, "more than %d seeds in one dose: use a second one", TROCAR_MAX_DOSE_SEEDS);
    if (d->next_id == INT32_MAX) return fail(why, TROCAR_BAD_INPUT, "2^31 seeds were added to this dose: create a new one");
    if (d->seed_count < d->room) return TROCAR_OK;
    int room = d->room ? 2 * d->room : 64;
    listed_seed *seeds = realloc(d->seeds, (size_t)room * sizeof *seeds);
    if (!seeds) return fail(why, TROCAR_NO_MEMORY, "no memory for %d seeds", room);
    d->seeds = seeds;
    d->room = room;
    return TROCAR_OK;
}

static listed_seed *find(trocar_dose *d, int32_t id, trocar_error *why) {
    for (int i = 0; i < d->seed_count; i++)
        if (d->seeds[i].id == id) return &d->seeds[i];
    fail(why, TROCAR_BAD_INPUT, "no seed has the id %d: it was removed, or never added", id);
    return NULL;
}

trocar_status trocar_dose_add(trocar_dose *d, const trocar_dose_seed *seed, int32_t *id, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_status status = check_seed(seed, why);
    if (status == TROCAR_OK) status = make_room(d, why);
    if (status != TROCAR_OK) return status;
    floating_mode before = flush_denormals();
    accumulate(d, seed, 1);
    restore_floating_mode(before);
    if (id) *id = d->next_id;
    d->seeds[d->seed_count++] = (listed_seed){d->next_id++, *seed};
    return TROCAR_OK;
}

trocar_status trocar_dose_remove(trocar_dose *d, int32_t id, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    listed_seed *seed = find(d, id, why);
    if (!seed) return TROCAR_BAD_INPUT;
    floating_mode before = flush_denormals();
    accumulate(d, &seed->given, -1);
    restore_floating_mode(before);
    *seed = d->seeds[--d->seed_count];
    return TROCAR_OK;
}

trocar_status trocar_dose_move(trocar_dose *d, int32_t id, const trocar_dose_seed *to, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    listed_seed *seed = find(d, id, why);
    if (!seed || check_seed(to, why) != TROCAR_OK) return TROCAR_BAD_INPUT;
    floating_mode before = flush_denormals();
    accumulate(d, &seed->given, -1);
    accumulate(d, to, 1);
    restore_floating_mode(before);
    seed->given = *to;
    return TROCAR_OK;
}

/* Returns the rest position of a point in `p`. */
static void point_at_rest(const trocar_dose *d, int64_t index, double p[3]) {
    point_block one;
    if (d->points) take_listed(d->points + 3 * index, 1, &one);
    else take_voxels(&d->grid, index, 1, &one);
    p[0] = one.x[0];
    p[1] = one.y[0];
    p[2] = one.z[0];
}

trocar_status trocar_dose_displace(trocar_dose *d, const double *displacements, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    double p[3];
    for (int64_t i = 0; displacements && i < d->count; i++) {
        point_at_rest(d, i, p);
        for (int k = 0; k < 3; k++) p[k] += displacements[3 * i + k];
        if (!is_near(p))
            return fail(why, TROCAR_BAD_INPUT, "point %lld is displaced to (%g, %g, %g): expected finite numbers, at most 1000 m", (long long)i, p[0], p[1], p[2]);
    }
    if (displacements && !d->moved) d->moved = malloc(3 * (size_t)d->count * sizeof *d->moved);
    if (displacements && !d->moved) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements of %lld points", (long long)d->count);
    for (int64_t i = 0; displacements && i < d->count; i++) {
        point_at_rest(d, i, p);
        for (int k = 0; k < 3; k++) d->moved[3 * i + k] = p[k] + displacements[3 * i + k];
    }
    d->displaced = displacements != NULL;
    memset(d->quanta, 0, (size_t)d->count * sizeof *d->quanta);
    floating_mode before = flush_denormals();
    for (int i = 0; i < d->seed_count; i++) accumulate(d, &d->seeds[i].given, 1);
    restore_floating_mode(before);
    return TROCAR_OK;
}

int64_t trocar_dose_point_count(const trocar_dose *dose) { return dose->count; }
int trocar_dose_seed_count(const trocar_dose *dose) { return dose->seed_count; }

void trocar_dose_values(const trocar_dose *dose, double *values) {
    for (int64_t i = 0; i < dose->count; i++) values[i] = TROCAR_DOSE_QUANTUM * (double)dose->quanta[i];
}
