/* One simulation of a batch or of a rollout. */
#ifndef TROCAR_BATCH_ROW_H
#define TROCAR_BATCH_ROW_H

#include "api/api.h"

enum { MAX_THREADS = 256 };   /* most threads that a batch or a rollout may use */

/* A simulation and the state that a reset restores. */
typedef struct {
    trocar_sim *sim;
    void *fresh;             /* state saved just after `sim` was created */
    size_t fresh_bytes;
} batch_row;

/* `workspace`: as for sim_create. */
trocar_status row_create(trocar_model *model, insertion_workspace *workspace, batch_row *row, trocar_error *why);
void row_free(batch_row *row); /* `row` may be zeroed already, and is zeroed afterwards */

/* Restores the state saved at creation, so that earlier steps do not affect the results. Then straightens the needles and places their bases at
   `poses`[needles]. */
trocar_status row_reset(const batch_row *row, int needles, const trocar_pose *poses, trocar_error *why);

/* Returns BAD_INPUT if the model has only a mesh, or has fewer than `needles` needles. */
trocar_status check_driven_needles(const trocar_model *model, int needles, trocar_error *why);

/* Ticks needles 0 to `needles` - 1 in turn, with their bases at `poses`[needles]. A resting needle is not ticked: its pose is not read, and its force, torque
   and events are 0. If a tick fails, the needles before it have already been ticked. */
trocar_status step_needles(trocar_sim *sim, int needles, const trocar_pose *poses, double dt, trocar_output *outputs, trocar_error *why);

#endif
