#define _GNU_SOURCE
#include "view/implant/implant.h"

#include <stdlib.h>

#include "shared/json.h"
#include "trocar_command_t.h"
#include "view/hand/hole_approach.h"

/* Replaces a section with the JSON that `write` produces. If out of memory, leaves it as it is. */
static void set_json(web_section *s, section_kind kind, void (*write)(json *, const void *), const void *what) {
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return;
    json j = {.out = out};
    write(&j, what);
    fclose(out);
    bytes_clear(&s->bytes);
    encode_json(&s->bytes, kind, text);
    s->version++;
    free(text);
}

static void write_plan(json *j, const void *what) {
    const plan_table *plan = what;
    json_open(j, NULL, '[');
    for (const planned_seed *s = plan->seeds; s < plan->seeds + plan->count; s++) {
        json_open(j, NULL, '{');
        json_text(j, "hole", s->hole);
        json_numbers(j, "position", s->position, 3);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static const char *word_of_command(int32_t command) {
    static const char *const words[] = {[TROCAR_COMMAND_T_RESET] = "remove", [TROCAR_COMMAND_T_LEAVE] = "leave", [TROCAR_COMMAND_T_TAKE] = "take",
                                        [TROCAR_COMMAND_T_DROP_SEED] = "drop", [TROCAR_COMMAND_T_UNDO] = "undo", [TROCAR_COMMAND_T_CLEAR] = "clear"};
    bool known = command >= 0 && (size_t)command < sizeof words / sizeof *words && words[command];
    return known ? words[command] : "other";
}

static void write_reply(json *j, const void *what) {
    const trocar_command_reply_t *reply = what;
    json_open(j, NULL, '{');
    json_integer(j, "number", reply->seq);
    json_integer(j, "needle", reply->needle);
    json_text(j, "command", word_of_command(reply->command));
    json_bool(j, "done", reply->status == TROCAR_COMMAND_REPLY_T_DONE);
    json_text(j, "message", reply->message);
    json_close(j, '}');
}

trocar_status implant_open(implant *i, const trocar_model *model, const implant_settings *settings, trocar_error *why) {
    bool plans = settings->plan != NULL;
    int template = find_template(model);
    if (template < 0) return plans ? fail(why, TROCAR_BAD_INPUT, "--plan: the scene has no template (guides)") : TROCAR_OK;
    trocar_guide guide = trocar_model_guide(model, template);
    trocar_status status = plans ? plan_table_read(settings->plan, &i->plan, why) : TROCAR_OK;
    if (plans && status == TROCAR_OK) status = plan_table_fits(&i->plan, &guide, settings->plan, why);
    if (status != TROCAR_OK) return status;
    if (plans) set_json(&i->sections[IMPLANT_PLAN], SECTION_PLAN, write_plan, &i->plan);
    return dose_thread_create(model, &settings->dose, plans ? &i->plan : NULL, &i->dose, why);
}

void implant_close(implant *i) {
    if (i->dose) dose_thread_free(i->dose);
    for (int s = 0; s < IMPLANT_SECTIONS; s++) bytes_free(&i->sections[s].bytes);
    *i = (implant){.dose = NULL};
}

static void take_seeds(implant *i, const trocar_seeds_t *seeds, const trocar_deformation_t *deformation) {
    static const trocar_seeds_t none = {0};
    web_section *s = &i->sections[IMPLANT_SEEDS];
    bytes_clear(&s->bytes);
    encode_seeds(&s->bytes, seeds ? seeds : &none);
    s->version++;
    if (i->dose) dose_thread_tell(i->dose, seeds, deformation);
}

void implant_hear(implant *i, const subscriber *feed) {
    if (feed->seeds_heard != i->seeds_heard) take_seeds(i, feed->seeds, feed->deformation);
    if (feed->replies_heard != i->replies_heard && feed->reply) set_json(&i->sections[IMPLANT_REPLY], SECTION_REPLY, write_reply, feed->reply);
    else if (feed->replies_heard != i->replies_heard) bytes_clear(&i->sections[IMPLANT_REPLY].bytes); /* drop the previous server's reply */
    i->seeds_heard = feed->seeds_heard;
    i->replies_heard = feed->replies_heard;
}

void implant_note_dose(implant *i) {
    web_section *s = &i->sections[IMPLANT_DOSE];
    if (dose_thread_take(i->dose, &s->bytes)) s->version++;
}
