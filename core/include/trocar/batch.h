/* Many simulations, stepped together in several threads. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_BATCH_H
#define TROCAR_PUBLIC_BATCH_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A set of simulations, called rows, of one or more models. Each row runs in lockstep and gives exactly the results of trocar_sim_step, whatever the number
   of threads and whatever the other rows do. In the shapes below, R is the number of rows, S the number of steps of a call, and N the number of needles that
   are driven in each row. A mask has R entries, which are nonzero for the rows that a call applies to; NULL means all rows. */
typedef struct trocar_batch trocar_batch;

typedef struct trocar_batch_options {
    int threads;             /* number of threads, including the caller's, 1 to 256; 0: one for each processor that the process may use */
    int needles;             /* N: needles 0 to N - 1 of each row are driven, one after another in each step */
} trocar_batch_options;

/* Returns the defaults: one thread for each processor, one needle. [any, RT] */
TROCAR_API trocar_batch_options trocar_default_batch_options(void);

/* Creates `rows` simulations. Row i is a simulation of models[i]; several rows may share a model. Every needle is straight, with its base at the origin, until
   the row is reset. `options`: NULL for the defaults. A row takes up 5 to 7 MB (docs/library.md). If there is not enough memory for all threads, fewer are
   started. BAD_INPUT for options out of range and for a model that has fewer than N needles or was created with mesh_only; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_batch_create(trocar_model *const *models, int rows, const trocar_batch_options *options, trocar_batch **batch,
                                             trocar_error *error);
TROCAR_API void trocar_batch_free(trocar_batch *batch); /* [alone] */

TROCAR_API int trocar_batch_rows(const trocar_batch *batch);    /* R. [any, RT] */
TROCAR_API int trocar_batch_needles(const trocar_batch *batch); /* N. [any, RT] */
TROCAR_API int trocar_batch_threads(const trocar_batch *batch); /* number of threads that were started, including the caller's. [any, RT] */

/* Returns a row's simulation. Between calls to functions of this header, it can be used like any other simulation in lockstep: for views, seeds, leaving and
   taking needles, the probe, and saving. The simulation belongs to the batch, and is valid until trocar_batch_set_model replaces it or the batch is freed. It
   cannot have a worker thread, and only one thread at a time may use the batch and its rows. Returns NULL if `row` is out of range. [one] */
TROCAR_API trocar_sim *trocar_batch_sim(trocar_batch *batch, int row);

/* Replaces a row's simulation with a new one of another model, such as a derived model. After an error, the row is unchanged. BAD_INPUT as in
   trocar_batch_create, or if `row` is out of range; NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_batch_set_model(trocar_batch *batch, int row, trocar_model *model, trocar_error *error);

/* ---- starting and continuing ---- */

/* Returns the rows of the mask to the state in which they were created, at time 0 and without seeds, tracks or resting needles, and places their driven
   needles, straight, at `poses`, [R][N]. The poses of other rows are not read. An error in one row does not stop the others; if several rows fail, the error of
   the row with the lowest index is returned: BAD_INPUT as in trocar_sim_reset, or NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_batch_reset(trocar_batch *batch, const trocar_pose *poses, const uint8_t *mask, trocar_error *error);

/* Save each row of the mask to states[row], which has `size` bytes, as trocar_sim_save does, or restore it from states[row], which has sizes[row] bytes, as
   trocar_sim_restore does. Several rows may be restored from the same state. Entries of other rows are not read. An error in one row does not stop the others;
   if several rows fail, the error of the row with the lowest index is returned. [one, allocates] */
TROCAR_API trocar_status trocar_batch_save(trocar_batch *batch, void *const *states, size_t size, const uint8_t *mask, trocar_error *error);
TROCAR_API trocar_status trocar_batch_restore(trocar_batch *batch, const void *const *states, const size_t *sizes, const uint8_t *mask, trocar_error *error);

/* ---- stepping ---- */

/* The caller's arrays for the results of a call. Results whose array is NULL are not computed. Units and meanings are those of trocar_output. */
typedef struct trocar_batch_outputs {
    double *force;           /* [R][S][N][3], N */
    double *torque;          /* [R][S][N][3], N m */
    double *depth;           /* [R][S][N], m */
    trocar_pose *tip;        /* [R][S][N], pose of the needle's end: position (m), and orientation, with +z along the needle and +y where the bevel faces */
    int32_t *contacts;       /* [R][S][N] */
    uint32_t *events;        /* [R][S][N] */
    int32_t *membrane;       /* [R][S][N] */
    int32_t *passes;         /* [R][S][N] */
    int32_t *switches;       /* [R][S][N] */
    int32_t *seeds;          /* [R][S], number of seeds in the tissue after the step */
    int32_t *status;         /* [R], trocar_status of the row */
    int32_t *done;           /* [R], number of completed steps */
} trocar_batch_outputs;

/* Computes `steps` ticks of `dt` seconds for the rows of the mask, with the needles' bases at `poses`, [R][S][N]. Several steps in one call are faster than
   separate calls, because each row's data stay in the processor's cache. A needle that rests is not ticked: its pose is not read, and its force, torque and
   events are 0. Entries of rows outside the mask are neither read nor written. If a step of a row fails, the row takes no further steps, and its outputs are
   zero from that step on; part of the failed step may have been carried out. The other rows complete all steps. If several rows fail, the error of the row with
   the lowest index is returned; its message names the row and the step. `watch` may be NULL; its functions are called in the calling thread, at least once for
   every 64 steps of a row. After a cancelled call, rows may be at different steps, as listed in `done`. BAD_INPUT as in trocar_sim_step, and, before anything
   is computed, for steps < 0 or dt outside (0, 1]; NUMERIC, NO_MEMORY, CANCELLED. [one, allocates] */
TROCAR_API trocar_status trocar_batch_step(trocar_batch *batch, const trocar_pose *poses, int steps, double dt, const uint8_t *mask,
                                           const trocar_watch *watch, const trocar_batch_outputs *outputs, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
