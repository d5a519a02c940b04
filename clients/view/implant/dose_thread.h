/* A low-priority thread that computes the dose of the seeds, both on a grid in the deformed tissue and in the organs (organ_dose.h). If several inputs arrive
   during a computation, only the newest is used. */
#ifndef TROCAR_DOSE_THREAD_H
#define TROCAR_DOSE_THREAD_H

#include "base/error.h"
#include "shared/plan_table.h"
#include "trocar.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "view/stream/wire_format.h"

typedef struct {
    const char *source;      /* a seed model in the library, or the path of a table that ends in .yaml */
    double strength;         /* U, of each seed */
    double prescription;     /* Gy */
    double swelling;         /* the gland's volume on the day of the implant divided by its volume once the swelling has gone; at least 1 */
} dose_settings;

typedef struct dose_thread dose_thread;

/* Starts the thread. The organs are the regions, with their parts, whose names contain prostate or gland, urethra, and rectum. If `plan` is not NULL, also
   computes the dose that the plan gives them. `settings` must outlive the thread. Returns BAD_INPUT if the seed model does not exist or is invalid, SYSTEM, or
   NO_MEMORY. */
trocar_status dose_thread_create(const trocar_model *model, const dose_settings *settings, const plan_table *plan,
                                 dose_thread **created, trocar_error *why);
void dose_thread_free(dose_thread *t);

/* Passes the current seeds and displacements to the thread; NULL means no seeds, or undeformed tissue. Does not wait. */
void dose_thread_tell(dose_thread *t, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation);

/* Returns a descriptor that becomes readable when there is a new result. */
int dose_thread_descriptor(const dose_thread *t);

/* Replaces `section` with the newest result. Returns false if there is none. */
bool dose_thread_take(dose_thread *t, byte_buffer *section);

#endif
