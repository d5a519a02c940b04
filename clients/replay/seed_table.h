/* Writes the seeds of a simulation as a table with one row per seed. */
#ifndef TROCAR_SEED_TABLE_H
#define TROCAR_SEED_TABLE_H

#include "shared/patient.h"

/* Writes the name of a guide's hole as clinicians use it, such as C3.5: a letter for the column, starting with A, and a number for the row, starting
   with 1, in steps of 0.5. Columns after Z are AA, AB and so on. */
void hole_name(const trocar_guide *guide, int hole, char name[16]);

/* Writes a CSV file with the position and direction of each seed, both in the displaced tissue and at rest. If `frame` is given, uses patient
   coordinates. NO_MEMORY. */
trocar_status seed_table_write(FILE *file, const trocar_scene *scene, const trocar_model *model, trocar_sim *sim, const patient_frame *frame,
                               trocar_error *why);

#endif
