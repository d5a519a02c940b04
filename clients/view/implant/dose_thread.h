/* A low-priority thread that computes the seeds' dose: on a grid in space, in the displaced tissue, and in the organs (organ_dose.h). If several
   inputs arrive during a computation, only the newest one is used. */
#ifndef TROCAR_DOSE_THREAD_H
#define TROCAR_DOSE_THREAD_H

#include "base/error.h"
#include "shared/plan_table.h"
#include "trocar.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "view/stream/wire_format.h"

typedef struct {
    const char *source;      /* name of a seed model in the library, or path of a table that ends in .yaml */
    double strength;         /* U, strength of each seed */
    double prescription;     /* Gy */
    double swelling;         /* volume of the gland on the day of the implant divided by its volume after the swelling has subsided; at least 1 */
} dose_settings;

typedef struct dose_thread dose_thread;

/* Starts the thread. Organs are the regions whose names contain prostate or gland, urethra, rectum, with their parts. If `plan` is not NULL, the plan's
   dose in the organs is computed as well. `settings` must outlive the thread. BAD_INPUT for a seed model that does not exist or is invalid; SYSTEM;
   NO_MEMORY. */
trocar_status dose_thread_create(const trocar_model *model, const dose_settings *settings, const plan_table *plan,
                                 dose_thread **created, trocar_error *why);
void dose_thread_free(dose_thread *t);

/* Passes the current seeds and displacements to the thread; NULL stands for no seeds, or for tissue at rest. Does not wait. */
void dose_thread_tell(dose_thread *t, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation);

/* Returns a descriptor that is readable when there is a new result. */
int dose_thread_descriptor(const dose_thread *t);

/* Replaces `section` with the newest result. Returns false if there is no new result. */
bool dose_thread_take(dose_thread *t, byte_buffer *section);

#endif
