/* Passes the newest section from the thread that computes it to the thread that sends it to browsers. A section that has not been taken is overwritten. */
#ifndef TROCAR_SECTION_BOX_H
#define TROCAR_SECTION_BOX_H

#include <stdatomic.h>
#include <stdbool.h>

#include "view/stream/wire_format.h"

typedef struct {
    _Atomic(byte_buffer *) section; /* NULL once it has been taken */
    int ready;                      /* eventfd, readable when there may be a section; -1 if it could not be created */
} section_box;

void section_box_create(section_box *box);
void section_box_free(section_box *box);

/* Takes ownership of the section, and signals `ready`. Drops an empty section. */
void section_box_put(section_box *box, byte_buffer section);

/* Replaces `section` with the newest one. Returns false if there is none. Does not block. */
bool section_box_take(section_box *box, byte_buffer *section);

#endif
