/* What browsers receive about an implant: the seeds, the reply to the last command, the dose and the plan. */
#ifndef TROCAR_IMPLANT_H
#define TROCAR_IMPLANT_H

#include "view/implant/dose_thread.h"
#include "view/stream/subscriber.h"
#include "view/web/web.h"

typedef enum { IMPLANT_SEEDS, IMPLANT_REPLY, IMPLANT_DOSE, IMPLANT_PLAN, IMPLANT_SECTIONS } implant_section;
_Static_assert((int)IMPLANT_SECTIONS < (int)WEB_SECTIONS, "see web.h");

typedef struct {
    const char *plan;        /* path of a plan's table; NULL for none */
    dose_settings dose;
} implant_settings;

typedef struct {
    web_section sections[IMPLANT_SECTIONS];
    int64_t seeds_heard, replies_heard; /* the subscriber's counters when seeds and replies were last encoded */
    plan_table plan;
    dose_thread *dose;       /* NULL in a scene without a template, for which no dose is computed */
} implant;

/* Starts the dose thread and reads the plan. `settings` must outlive the implant. Returns BAD_INPUT if the plan or the seed model is invalid, or if there is a
   plan but no template. */
trocar_status implant_open(implant *i, const trocar_model *model, const implant_settings *settings, trocar_error *why);
void implant_close(implant *i);

/* Call it after messages have been received. */
void implant_hear(implant *i, const subscriber *feed);

/* Call it when the dose thread's descriptor is readable. */
void implant_note_dose(implant *i);

#endif
