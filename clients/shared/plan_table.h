/* Planned seeds, read from the table written by `python3 -m trocar.brachy.plan show --out`. */
#ifndef TROCAR_PLAN_TABLE_H
#define TROCAR_PLAN_TABLE_H

#include <stdbool.h>

#include "base/error.h"
#include "trocar.h"

enum { PLAN_HOLE = 8 };

typedef struct {
    char hole[PLAN_HOLE];        /* name such as C3.5 */
    double position[3];          /* m, the seed's centre in the tissue at rest */
} planned_seed;

typedef struct {
    int count;
    planned_seed seeds[TROCAR_MAX_SEEDS];
} plan_table;

/* Reads the table. BAD_INPUT with file, line and remedy if the file is not such a table. */
trocar_status plan_table_read(const char *path, plan_table *plan, trocar_error *why);

/* Checks that each seed lies on the axis of its hole in this template. Otherwise the plan was made for another template: BAD_INPUT, with the line in
   the table. */
trocar_status plan_table_fits(const plan_table *plan, const trocar_guide *guide, const char *path, trocar_error *why);

#endif
