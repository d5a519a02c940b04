/* Planned seeds, as read from the table that `python3 -m trocar.brachy.plan show --out` writes. */
#ifndef TROCAR_PLAN_TABLE_H
#define TROCAR_PLAN_TABLE_H

#include <stdbool.h>

#include "base/error.h"
#include "trocar.h"

enum { PLAN_HOLE = 8 };

typedef struct {
    char hole[PLAN_HOLE];        /* such as C3.5 */
    double position[3];          /* m, the seed's centre in the undeformed tissue */
} planned_seed;

typedef struct {
    int count;
    planned_seed seeds[TROCAR_MAX_SEEDS];
} plan_table;

/* Reads the table. If the file is not such a table, returns BAD_INPUT with the file, the line and the remedy. */
trocar_status plan_table_read(const char *path, plan_table *plan, trocar_error *why);

/* Checks that each seed lies on the axis of its hole in this template. If one does not, the plan was made for another template: returns BAD_INPUT with the line
   in the table. */
trocar_status plan_table_fits(const plan_table *plan, const trocar_guide *guide, const char *path, trocar_error *why);

#endif
