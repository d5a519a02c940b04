#include "shared/events.h"

#include <stdbool.h>
#include <stdio.h>

#include "message_words.h"
#include "trocar_needle_wrench_t.h"

/* Writes the names of the bits that are set, separated by `separator`. After "puncture" comes the membrane's name, unless it is NULL. */
static void words_text(const message_word *words, size_t count, unsigned bits, const char *membrane, const char *separator, char *text,
                       size_t size) {
    size_t used = 0;
    text[0] = '\0';
    for (size_t i = 0; i < count && used < size; i++) {
        if (!(bits & (unsigned)words[i].bit)) continue;
        bool puncture = membrane && words[i].bit == TROCAR_NEEDLE_WRENCH_T_EVENT_PUNCTURE;
        used += (size_t)snprintf(text + used, size - used, "%s%s%s%s", used ? separator : "", words[i].word, puncture ? ":" : "",
                                 puncture ? membrane : "");
    }
}

void events_text(unsigned events, const char *membrane, char *text, size_t size) {
    words_text(event_words, sizeof event_words / sizeof *event_words, events, membrane, "|", text, size);
}

void flags_text(unsigned flags, char *text, size_t size) {
    words_text(flag_words, sizeof flag_words / sizeof *flag_words, flags, NULL, ", ", text, size);
}

bool flag_at(int index, unsigned *bit, const char **word) {
    if (index < 0 || (size_t)index >= sizeof flag_words / sizeof *flag_words) return false;
    *bit = (unsigned)flag_words[index].bit;
    *word = flag_words[index].word;
    return true;
}
