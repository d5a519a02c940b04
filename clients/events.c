#include "events.h"

#include <stdio.h>

#include "insertion/insertion.h"

static const struct { unsigned bit; const char *word; } words[] = {
    {EVENT_TOUCHED, "touched"},     {EVENT_PUNCTURED, "puncture"},   {EVENT_ADDED, "added"},
    {EVENT_REMOVED, "removed"},     {EVENT_EXITED, "exited"},        {EVENT_REENTERED, "reentered"},
    {EVENT_WITHDRAWN, "withdrawn"}, {EVENT_LATE, "late"},            {EVENT_FULL, "full"},
    {EVENT_UNSTABLE, "unstable"},   {EVENT_KEPT, "kept"},
};

void events_text(unsigned events, const char *membrane, char *text, size_t size) {
    size_t used = 0;
    text[0] = '\0';
    for (size_t i = 0; i < sizeof words / sizeof *words && used < size; i++) {
        if (!(events & words[i].bit)) continue;
        int length = snprintf(text + used, size - used, "%s%s%s%s", used ? "|" : "", words[i].word,
                              words[i].bit == EVENT_PUNCTURED ? ":" : "", words[i].bit == EVENT_PUNCTURED ? membrane : "");
        used += (size_t)length;
    }
}
