#include "view/implant/organ_dose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double SPACING = 1e-3; /* m, voxel spacing */

trocar_status organ_create(organ *o, const trocar_model *m, const trocar_mesh *mesh, int region, trocar_error *why) {
    *o = (organ){.name = trocar_model_region_name(m, region), .low = {-INFINITY, -INFINITY, -INFINITY}, .high = {INFINITY, INFINITY, INFINITY}};
    trocar_status status = trocar_structure_from_region(mesh, region, SPACING, &o->structure, why);
    if (status != TROCAR_OK) return status;
    size_t count = (size_t)trocar_structure_count(o->structure);
    o->points = malloc(3 * count * sizeof *o->points);
    o->doses = malloc(count * sizeof *o->doses);
    return o->points && o->doses ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the dose");
}

void organ_free(organ *o) {
    if (o->structure) trocar_structure_free(o->structure);
    free(o->points);
    free(o->doses);
}

void organ_centre(const organ *o, double centre[3]) {
    const double *points = trocar_structure_points(o->structure);
    int64_t count = trocar_structure_count(o->structure);
    for (int a = 0; a < 3; a++) {
        double sum = 0.0;
        for (int64_t i = 0; i < count; i++) sum += points[3 * i + a];
        centre[a] = sum / (double)count;
    }
}

void organ_limit(organ *o, const organ *other) {
    const double *points = trocar_structure_points(other->structure);
    for (int a = 0; a < 3; a++) {
        o->low[a] = INFINITY, o->high[a] = -INFINITY;
        for (int64_t i = 0; i < trocar_structure_count(other->structure); i++) {
            o->low[a] = fmin(o->low[a], points[3 * i + a]);
            o->high[a] = fmax(o->high[a], points[3 * i + a]);
        }
    }
}

static bool is_judged(const organ *o, const double point[3]) {
    for (int a = 0; a < 3; a++)
        if (point[a] < o->low[a] || point[a] > o->high[a]) return false;
    return true;
}

bool organ_contains(const organ *o, const double point[3]) {
    const double *p = trocar_structure_points(o->structure);
    for (int64_t i = 0; i < trocar_structure_count(o->structure); i++, p += 3)
        if (fabs(p[0] - point[0]) <= 0.5 * SPACING && fabs(p[1] - point[1]) <= 0.5 * SPACING && fabs(p[2] - point[2]) <= 0.5 * SPACING) return true;
    return false;
}

void shrink(const shrinkage *s, const double from[3], double to[3]) {
    for (int a = 0; a < 3; a++) to[a] = s->centre[a] + s->scale * (from[a] - s->centre[a]);
}

/* Moves the voxel centres to where they are in this state. */
static void place_voxels(organ *o, dose_state state, const double *nodal, const shrinkage *shrunk) {
    const double *rest = trocar_structure_points(o->structure);
    int64_t count = trocar_structure_count(o->structure);
    bool moves = state == DOSE_NOW && nodal && trocar_structure_displacements(o->structure, nodal, o->points, NULL) == TROCAR_OK;
    for (int64_t i = 0; i < 3 * count; i++) o->points[i] = moves ? o->points[i] + rest[i] : rest[i];
    if (state != DOSE_SWELLING_GONE || !o->shrinks) return;
    for (int64_t i = 0; i < count; i++) shrink(shrunk, rest + 3 * i, o->points + 3 * i);
}

void organ_compute(organ *o, dose_state state, const trocar_dose_source *source, const trocar_dose_seed *seeds, int seed_count, double prescription,
                   const double *nodal, const shrinkage *shrunk) {
    organ_result *r = &o->results[state];
    const double *rest = trocar_structure_points(o->structure);
    int64_t all = trocar_structure_count(o->structure), count = 0;
    double hours = trocar_dose_hours(source, INFINITY), voxel = trocar_structure_voxel(o->structure);
    if (state == DOSE_SWELLING_GONE && o->shrinks) voxel *= shrunk->scale * shrunk->scale * shrunk->scale;
    place_voxels(o, state, nodal, shrunk);
    bool dosed = seed_count > 0 && trocar_dose_rates(source, seeds, seed_count, o->points, all, o->doses, NULL) == TROCAR_OK;
    for (int64_t i = 0; i < all; i++)
        if (is_judged(o, rest + 3 * i)) o->doses[count++] = dosed ? hours * o->doses[i] : 0.0;
    r->known = trocar_dvh_sort(o->doses, count, NULL) == TROCAR_OK;
    if (!r->known) return;
    r->summary = trocar_dvh_summarise(o->doses, count, voxel, prescription);
    for (int i = 0; i < DVH_POINTS; i++) r->curve[i] = trocar_dvh_volume(o->doses, count, DVH_TOP * prescription * i / (DVH_POINTS - 1));
}
