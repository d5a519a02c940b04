/* The data about an implant that browsers receive: the seeds, the answer to the last command, the dose and the plan. */
#ifndef TROCAR_IMPLANT_H
#define TROCAR_IMPLANT_H

#include "view/implant/dose_thread.h"
#include "view/stream/subscriber.h"
#include "view/web/web.h"

typedef enum { IMPLANT_SEEDS, IMPLANT_REPLY, IMPLANT_DOSE, IMPLANT_PLAN, IMPLANT_SECTIONS } implant_section;
_Static_assert((int)IMPLANT_SECTIONS < (int)WEB_SECTIONS, "see web.h");

typedef struct {
    const char *plan;        /* path of a plan's table; NULL if there is none */
    dose_settings dose;
} implant_settings;

typedef struct {
    web_section sections[IMPLANT_SECTIONS];
    int64_t seeds_heard, replies_heard; /* the subscriber's counters when seeds and replies were last encoded */
    plan_table plan;
    dose_thread *dose;       /* NULL if the scene has no template, so that no dose is computed */
} implant;

/* Starts the dose thread and reads the plan. `settings` must outlive the implant. BAD_INPUT for an invalid plan or seed model, and for a plan in a
   scene without a template. */
trocar_status implant_open(implant *i, const trocar_model *model, const implant_settings *settings, trocar_error *why);
void implant_close(implant *i);

/* Must be called after messages have been received. */
void implant_hear(implant *i, const subscriber *feed);

/* Must be called when the dose thread's descriptor is readable. */
void implant_note_dose(implant *i);

#endif
