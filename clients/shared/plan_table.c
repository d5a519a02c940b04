#define _GNU_SOURCE
#include "shared/plan_table.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/input_file.h"
#include "common/messages.h"
#include "shared/template_holes.h"

static const double BESIDE = 0.5e-3;  /* m: a seed farther than this from its hole's axis was planned for another template */
static const char HEADER[] = "hole,seed,x [m],y [m],z [m]"; /* further columns may give the same values in patient coordinates */
static const char REMEDY[] = "write this table with python3 -m trocar.brachy.plan show PLAN --scene SCENE --out FILE";

/* Parses a line such as "C3.5,1,0.02,...". Returns false if it does not describe a seed. */
static bool read_seed(const char *line, planned_seed *s) {
    double *x = s->position;
    if (sscanf(line, "%7[A-Za-z0-9.],%*d,%lf,%lf,%lf", s->hole, &x[0], &x[1], &x[2]) != 4) return false;
    return fabs(x[0]) < 1e3 && fabs(x[1]) < 1e3 && fabs(x[2]) < 1e3; /* also false for NaN */
}

static trocar_status read_lines(FILE *file, const char *path, plan_table *plan, trocar_error *why) {
    char line[512];
    if (!fgets(line, sizeof line, file) || strncmp(line, HEADER, sizeof HEADER - 1) != 0)
        return fail(why, TROCAR_BAD_INPUT, "%s:1: not a table of planned seeds: %s", path, REMEDY);
    for (int number = 2; fgets(line, sizeof line, file); number++) {
        if (plan->count == TROCAR_MAX_SEEDS) return fail(why, TROCAR_BAD_INPUT, "%s:%d: more than %d seeds", path, number, (int)TROCAR_MAX_SEEDS);
        if (!read_seed(line, &plan->seeds[plan->count++]))
            return fail(why, TROCAR_BAD_INPUT, "%s:%d: not a hole, a number and a position in metres: %s", path, number, REMEDY);
    }
    return TROCAR_OK;
}

trocar_status plan_table_read(const char *path, plan_table *plan, trocar_error *why) {
    *plan = (plan_table){.count = 0};
    const char *reason;
    FILE *file = input_open(path, &reason);
    if (!file) return fail(why, TROCAR_BAD_INPUT, "%s: cannot be opened: %s", path, reason);
    trocar_status status = read_lines(file, path, plan, why);
    fclose(file);
    return status;
}

trocar_status plan_table_fits(const plan_table *plan, const trocar_guide *guide, const char *path, trocar_error *why) {
    for (int i = 0; i < plan->count; i++) {
        const planned_seed *s = &plan->seeds[i];
        int column, row, line = i + 2;
        if (!find_hole(guide, s->hole, &column, &row))
            return fail(why, TROCAR_BAD_INPUT, "%s:%d: the scene's template has no hole %s: it has %d x %d; choose the scene that the plan was made for", path, line,
                        s->hole, guide->columns, guide->rows);
        pose entry = hole_entry(guide, column, row);
        vec3 axis = q_axis(entry.orientation), from = v3_sub(load_vec3(s->position), entry.position);
        double beside = v3_norm(v3_axpy(-v3_dot(from, axis), axis, from));
        if (beside > BESIDE)
            return fail(why, TROCAR_BAD_INPUT, "%s:%d: the seed is %.1f mm beside hole %s of the scene's template: choose the scene that the plan was made for", path,
                        line, 1e3 * beside, s->hole);
    }
    return TROCAR_OK;
}
