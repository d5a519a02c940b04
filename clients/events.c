#include "events.h"

#include <stdbool.h>
#include <stdio.h>

#include "trocar.h"

static const struct { unsigned bit; const char *word; } words[] = {
    {TROCAR_EVENT_TOUCHED, "touched"},     {TROCAR_EVENT_PUNCTURED, "puncture"}, {TROCAR_EVENT_ADDED, "added"},
    {TROCAR_EVENT_REMOVED, "removed"},     {TROCAR_EVENT_EXITED, "exited"},      {TROCAR_EVENT_REENTERED, "reentered"},
    {TROCAR_EVENT_WITHDRAWN, "withdrawn"}, {TROCAR_EVENT_LATE, "late"},          {TROCAR_EVENT_FULL, "full"},
    {TROCAR_EVENT_UNSTABLE, "unstable"},   {TROCAR_EVENT_KEPT, "kept"},
};

void events_text(unsigned events, const char *membrane, char *text, size_t size) {
    size_t used = 0;
    text[0] = '\0';
    for (size_t i = 0; i < sizeof words / sizeof *words && used < size; i++) {
        if (!(events & words[i].bit)) continue;
        bool punctured = words[i].bit == TROCAR_EVENT_PUNCTURED;
        int length = snprintf(text + used, size - used, "%s%s%s%s", used ? "|" : "", words[i].word, punctured ? ":" : "",
                              punctured ? membrane : "");
        used += (size_t)length;
    }
}
