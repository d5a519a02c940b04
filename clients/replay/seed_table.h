/* Writes the seeds of a simulation as a table, one row per seed. */
#ifndef TROCAR_SEED_TABLE_H
#define TROCAR_SEED_TABLE_H

#include "shared/patient.h"

/* Writes the name that clinicians use for a guide's hole, such as C3.5: a letter for the column, from A, and a number for the row, from 1, in steps of 0.5.
   After Z come AA, AB and so on. */
void hole_name(const trocar_guide *guide, int hole, char name[16]);

/* Writes a CSV file with the position and direction of each seed, both in the deformed and in the undeformed tissue, in patient coordinates unless `frame` is
   NULL. Returns NO_MEMORY if out of memory. */
trocar_status seed_table_write(FILE *file, const trocar_scene *scene, const trocar_model *model, trocar_sim *sim, const patient_frame *frame,
                               trocar_error *why);

#endif
