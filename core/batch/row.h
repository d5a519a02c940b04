/* One simulation of a batch or of a rollout. */
#ifndef TROCAR_BATCH_ROW_H
#define TROCAR_BATCH_ROW_H

#include "api/api.h"

enum { MAX_THREADS = 256 };   /* maximum number of threads of a batch or a rollout */

/* A simulation, and the state that a reset restores. */
typedef struct {
    trocar_sim *sim;
    void *fresh;             /* state saved after the creation of `sim` */
    size_t fresh_bytes;
} batch_row;

/* `workspace`: as for sim_create. */
trocar_status row_create(trocar_model *model, insertion_workspace *workspace, batch_row *row, trocar_error *why);
void row_free(batch_row *row); /* `row` may be zeroed already, and is zeroed afterwards */

/* Restores the state saved after creation, so that earlier steps do not affect the results, and places the needles, straight, with their bases at
   `poses`[needles]. */
trocar_status row_reset(const batch_row *row, int needles, const trocar_pose *poses, trocar_error *why);

/* BAD_INPUT if the model has only a mesh, or fewer needles than are driven. */
trocar_status check_driven_needles(const trocar_model *model, int needles, trocar_error *why);

/* Ticks needles 0 to `needles` - 1, one after another, with their bases at `poses`[needles]. A needle that rests is not ticked: its pose is not read, and its
   force, torque and events are 0. If a tick fails, the needles before it have been ticked. */
trocar_status step_needles(trocar_sim *sim, int needles, const trocar_pose *poses, double dt, trocar_output *outputs, trocar_error *why);

#endif
