/* Finds a scene's template and its holes. */
#ifndef TROCAR_TEMPLATE_HOLES_H
#define TROCAR_TEMPLATE_HOLES_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

/* Returns the index of the scene's template, which is its first guide with more than one hole; -1 if there is none. */
int find_template(const trocar_model *model);

/* Finds the column and row, from 0, of the hole with this name, such as C3.5, in upper or lower case (see hole_name in seed_table.h). Returns false if the
   guide has no such hole. */
bool find_hole(const trocar_guide *guide, const char *name, int *column, int *row);

/* Returns the pose at which a needle enters the hole: its origin is where the hole's axis meets the entry face, z is along the hole and y along the rows; x is
   along the columns, or against them if `rows_along` makes columns, rows and normal left-handed. `column` and `row` count from 0, and may lie halfway between
   two holes. */
pose hole_entry(const trocar_guide *guide, double column, double row);

#endif
