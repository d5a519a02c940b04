/* A thread that computes the ultrasound images that browsers show, from the newest messages. If several arrive during a computation, only the newest is used.
   It works only while browsers ask for images. */
#ifndef TROCAR_SCANNER_H
#define TROCAR_SCANNER_H

#include "view/stream/subscriber.h"
#include "view/web/web.h"

typedef struct scanner scanner;

/* Starts the thread. `scene` and `model` must outlive it. Returns BAD_INPUT if a calcification is invalid, SYSTEM, or NO_MEMORY. */
trocar_status scanner_create(const trocar_scene *scene, const trocar_model *model, scanner **created, trocar_error *why);
void scanner_free(scanner *s);

/* Handles ACTION_LOOK, unless it contains values that are not finite. The newest request applies to all browsers, and expires after two seconds. */
void scanner_look(scanner *s, const web_action *action);

/* Passes the current state to the thread if images are wanted and something has changed. Does not wait. */
void scanner_tell(scanner *s, const subscriber *feed);

/* True while the images of the last state are not finished. */
bool scanner_busy(const scanner *s);

/* Returns a descriptor that becomes readable when there are new images. */
int scanner_descriptor(const scanner *s);

/* Replaces the section with the newest images. Returns false if there are no new ones. */
bool scanner_take(scanner *s, byte_buffer *section);

#endif
