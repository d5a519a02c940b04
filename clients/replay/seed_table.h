/* Writes the seeds of a simulation as a table with one row per seed. */
#ifndef TROCAR_SEED_TABLE_H
#define TROCAR_SEED_TABLE_H

#include "shared/patient.h"

/* Writes the name of a guide's hole as clinicians use it, such as C3.5: a letter for the column, from A, and a number for the row, from 1 in
   halves. Columns after Z are AA, AB and so on. */
void hole_name(const trocar_guide *guide, int hole, char name[16]);

/* Writes a CSV file with the position and direction of each seed, in the displaced tissue and at rest; in patient coordinates if a `frame` is
   given. NO_MEMORY. */
trocar_status seed_table_write(FILE *file, const trocar_scene *scene, const trocar_model *model, trocar_sim *sim, const patient_frame *frame,
                               report *why);

#endif
