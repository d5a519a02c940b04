#include "device/implant_errors.h"

#include <math.h>

#include "common/messages.h"

static const char *const NAMES[ERROR_PARTS] = {"total", "tissue", "image", "splay", "remainder"};

/* Searches the seeds reported by the server, from index `from` on, for the next one left by this needle. Returns its index, or -1 if there is none. */
static int next_seed(const implant_watch *watch, int needle, int from) {
    for (int i = from; i < watch->seed_count; i++)
        if (watch->seed_needles[i] == needle) return i;
    return -1;
}

static seed_error error_of(const implant_plan *plan, const trocar_operator_seed *seed, const double placed[3]) {
    seed_error e = {.seed = *seed, .axis = q_axis(plan->needles[seed->needle].entry.orientation)};
    e.parts[ERROR_TOTAL] = v3_sub(load_vec3(placed), load_vec3(seed->planned));
    e.parts[ERROR_TISSUE] = load_vec3(seed->tissue);
    e.parts[ERROR_IMAGE] = load_vec3(seed->image);
    e.parts[ERROR_SPLAY] = load_vec3(seed->splay);
    e.parts[ERROR_REMAINDER] = e.parts[ERROR_TOTAL];
    for (int i = ERROR_TISSUE; i <= ERROR_SPLAY; i++) e.parts[ERROR_REMAINDER] = v3_sub(e.parts[ERROR_REMAINDER], e.parts[i]);
    return e;
}

void implant_errors_find(const implant_plan *plan, const trocar_operator *op, const implant_watch *watch, implant_errors *errors) {
    static trocar_operator_seed dropped[TROCAR_MAX_SEEDS];
    int next[TROCAR_MAX_NEEDLES] = {0}, count = trocar_operator_seeds(op, dropped, TROCAR_MAX_SEEDS);
    errors->count = 0;
    for (int i = 0; i < count; i++) {
        int needle = dropped[i].needle, found = next_seed(watch, needle, next[needle]);
        if (found < 0) continue;
        next[needle] = found + 1;
        errors->seeds[errors->count++] = error_of(plan, &dropped[i], watch->seeds[found]);
    }
}

static double along(const seed_error *e, int part) { return v3_dot(e->parts[part], e->axis); }
static double across(const seed_error *e, int part) { return v3_norm(v3_axpy(-along(e, part), e->axis, e->parts[part])); }

void implant_errors_print(const implant_errors *errors, FILE *file) {
    double distance = 0;
    for (int i = 0; i < errors->count; i++) distance += v3_norm(errors->seeds[i].parts[ERROR_TOTAL]) / errors->count;
    fprintf(file, "misplacement        %.2f mm, mean of %d seeds in the tissue at rest\n", 1e3 * distance, errors->count);
    fprintf(file, "  in mm               along  |along|   across\n");
    for (int part = 0; part < ERROR_PARTS; part++) {
        double deeper = 0, length = 0, aside = 0;
        for (int i = 0; i < errors->count; i++) {
            deeper += along(&errors->seeds[i], part) / errors->count;
            length += fabs(along(&errors->seeds[i], part)) / errors->count;
            aside += across(&errors->seeds[i], part) / errors->count;
        }
        fprintf(file, "  %-15s %+9.2f %8.2f %8.2f\n", NAMES[part], 1e3 * deeper, 1e3 * length, 1e3 * aside);
    }
}

void implant_errors_write_csv(const implant_errors *errors, const implant_plan *plan, FILE *file) {
    fputs("needle,hole,seed,planned_x [m],planned_y [m],planned_z [m]", file);
    for (int part = 0; part < ERROR_PARTS; part++)
        for (int a = 0; a < 3; a++) fprintf(file, ",%s_%c [m]", NAMES[part], "xyz"[a]);
    fputs(",along [m],across [m]\n", file);
    for (int i = 0; i < errors->count; i++) {
        const seed_error *e = &errors->seeds[i];
        fprintf(file, "%d,%s,%d", e->seed.needle, plan->needles[e->seed.needle].hole, e->seed.number + 1);
        for (int a = 0; a < 3; a++) fprintf(file, ",%.7f", e->seed.planned[a]);
        for (int part = 0; part < ERROR_PARTS; part++) fprintf(file, ",%.7f,%.7f,%.7f", e->parts[part].x, e->parts[part].y, e->parts[part].z);
        fprintf(file, ",%.7f,%.7f\n", along(e, ERROR_TOTAL), across(e, ERROR_TOTAL));
    }
}
