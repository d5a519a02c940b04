/* The template of a scene, and its holes. */
#ifndef TROCAR_TEMPLATE_HOLES_H
#define TROCAR_TEMPLATE_HOLES_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

/* The scene's template: index of its first guide with more than one hole, -1: none. */
int find_template(const trocar_model *model);

/* A hole's column and row, from 0, by its name in capital or small letters, such as C3.5: see hole_name (seed_table.h). False if the guide has no
   such hole. */
bool find_hole(const trocar_guide *guide, const char *name, int *column, int *row);

/* Pose where a hole's axis meets the face at which needles enter. Its z is the hole's axis, y is along the rows; x is along the columns, or against
   them if `rows_along` makes columns, rows and normal a left-handed system. `column` and `row` from 0; one half more is between two holes. */
pose hole_entry(const trocar_guide *guide, double column, double row);

#endif
