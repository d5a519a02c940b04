/* Finds the template of a scene, and its holes. */
#ifndef TROCAR_TEMPLATE_HOLES_H
#define TROCAR_TEMPLATE_HOLES_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

/* Returns the scene's template: the index of its first guide with more than one hole, or -1 if there is none. */
int find_template(const trocar_model *model);

/* Finds a hole's column and row, from 0, by the hole's name in upper or lower case, such as C3.5: see hole_name (seed_table.h). False if the
   guide has no such hole. */
bool find_hole(const trocar_guide *guide, const char *name, int *column, int *row);

/* Returns the pose where a hole's axis meets the face at which needles enter. Its z axis is the hole's axis, and its y axis is along the rows; its x axis is
   along the columns, or against them if `rows_along` makes columns, rows and normal a left-handed system. `column` and `row` count from 0, and may lie half-way
   between two holes. */
pose hole_entry(const trocar_guide *guide, double column, double row);

#endif
