#include "view/stream/section_box.h"

#include <stdint.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/eventfd_signal.h"

void section_box_create(section_box *box) {
    atomic_init(&box->section, NULL);
    box->ready = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
}

static void discard(byte_buffer *section) {
    if (section) bytes_free(section);
    free(section);
}

void section_box_free(section_box *box) {
    discard(atomic_exchange(&box->section, NULL));
    if (box->ready >= 0) close(box->ready);
}

void section_box_put(section_box *box, byte_buffer section) {
    byte_buffer *given = malloc(sizeof *given);
    if (!given || section.length == 0) {
        bytes_free(&section);
        free(given);
        return;
    }
    *given = section;
    discard(atomic_exchange(&box->section, given));
    eventfd_signal(box->ready);
}

bool section_box_take(section_box *box, byte_buffer *section) {
    uint64_t count;
    if (read(box->ready, &count, sizeof count) < 0) return false;
    byte_buffer *newest = atomic_exchange(&box->section, NULL);
    if (!newest) return false;
    bytes_free(section);
    *section = *newest;
    free(newest);
    return true;
}
