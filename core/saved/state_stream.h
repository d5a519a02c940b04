/* Writes a saved state to memory or reads it back. The same functions define the format for both directions: each "passes", that is, writes or reads, the
   members of a struct that are in use, in a fixed order. */
#ifndef TROCAR_STATE_STREAM_H
#define TROCAR_STATE_STREAM_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    bool reading;            /* true to read members from memory, false to write them to memory without changing them */
    bool failed;             /* the memory was too small or a count out of range; from then on, nothing is passed */
    char *at, *end;          /* the rest of the memory; not modified when reading */
} state_stream;

state_stream stream_to(void *memory, size_t bytes);
state_stream stream_from(const void *memory, size_t bytes);

/* Writes or reads `bytes` bytes. Sets them to zero if reading fails. */
void stream_pass(state_stream *s, void *data, size_t bytes);

/* Writes or reads a count from 0 to `most`. Sets it to 0 if reading fails. */
void stream_count(state_stream *s, int *count, int most);

#define STREAM(s, value) stream_pass(s, &(value), sizeof(value))                             /* writes or reads a variable */
#define STREAM_ENTRIES(s, array, count) stream_pass(s, array, (size_t)(count) * sizeof *(array)) /* the first entries of an array */

#endif
