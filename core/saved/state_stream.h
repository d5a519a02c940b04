/* Writes a saved state to memory, or reads it from memory. The same functions define the format for both directions: each of them writes or reads ("passes")
   those members of a struct that are in use, in a fixed order. */
#ifndef TROCAR_STATE_STREAM_H
#define TROCAR_STATE_STREAM_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    bool reading;            /* true: members are read from memory; false: they are written to memory and do not change */
    bool failed;             /* true if the memory is too small or a count is out of range; nothing more is passed */
    char *at, *end;          /* the remaining memory, which is not modified when reading */
} state_stream;

state_stream stream_to(void *memory, size_t bytes);
state_stream stream_from(const void *memory, size_t bytes);

/* Writes or reads `bytes` bytes. If reading fails, they become zero. */
void stream_pass(state_stream *s, void *data, size_t bytes);

/* Writes or reads a number of entries from 0 to `most`. If reading fails, it becomes 0. */
void stream_count(state_stream *s, int *count, int most);

#define STREAM(s, value) stream_pass(s, &(value), sizeof(value))                             /* writes or reads a variable */
#define STREAM_ENTRIES(s, array, count) stream_pass(s, array, (size_t)(count) * sizeof *(array)) /* the first entries of an array */

#endif
