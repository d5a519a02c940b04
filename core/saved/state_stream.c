#include "saved/state_stream.h"

#include <string.h>

state_stream stream_to(void *memory, size_t bytes) { return (state_stream){.at = memory, .end = (char *)memory + bytes}; }

state_stream stream_from(const void *memory, size_t bytes) {
    return (state_stream){.reading = true, .at = (char *)memory, .end = (char *)memory + bytes};
}

void stream_pass(state_stream *s, void *data, size_t bytes) {
    s->failed = s->failed || bytes > (size_t)(s->end - s->at);
    if (s->failed) {
        if (s->reading) memset(data, 0, bytes);
        return;
    }
    memcpy(s->reading ? data : s->at, s->reading ? s->at : data, bytes);
    s->at += bytes;
}

void stream_count(state_stream *s, int *count, int most) {
    STREAM(s, *count);
    if (*count >= 0 && *count <= most) return;
    s->failed = true;
    if (s->reading) *count = 0;
}
