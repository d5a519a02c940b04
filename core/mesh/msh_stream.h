/* Numbers and words of an MSH file, which is text, or binary in either byte order. The first failure writes the message, with line or byte, and stays:
   after it all functions return 0. */
#ifndef TROCAR_MSH_STREAM_H
#define TROCAR_MSH_STREAM_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"

enum { MSH_WORD = 64 };

typedef struct {
    FILE *file;
    const char *path;        /* for messages */
    bool converted;          /* `file` was made from `path`: messages have no place in it */
    report *why;
    trocar_status status;
    uint64_t size;           /* bytes of the file */
    uint64_t line, word_line; /* from 1, counts only what is read as text; of the last word */
    bool binary, swapped;    /* how numbers are stored: set once $MeshFormat is known */
    char section[MSH_WORD];  /* name without $; "" before the first */
} msh_stream;

/* Fails with "file:line: " or "file: byte n: " before the message. Returns BAD_INPUT, or the status of an earlier failure, whose message stays. */
__attribute__((format(printf, 2, 3))) trocar_status msh_fail(msh_stream *s, const char *format, ...);

/* Numbers: in text separated by blanks or ends of lines, in binary of 4, 8 and 8 bytes. */
int msh_int(msh_stream *s);
uint64_t msh_size(msh_stream *s);
double msh_real(msh_stream *s);

/* Whole numbers that are text also in a binary file; the second one with the rest of its line. */
int64_t msh_text_int(msh_stream *s);
int64_t msh_text_int_line(msh_stream *s);

/* A real number as text. */
double msh_text_real(msh_stream *s);

/* What is between the double quotes of the rest of this line, or "" if there are none. A longer string is cut off at `room` - 1 characters. */
void msh_quoted(msh_stream *s, char *text, size_t room);

/* Reads the byte-order mark of a binary file: the number 1, 4 bytes. */
void msh_byte_order(msh_stream *s);

/* Goes to the next line that begins with $ and sets `section`. False at the end of the file, and after a failure. */
bool msh_next_section(msh_stream *s);

/* Reads the line $End..., which must follow here; or skips all lines before it. */
void msh_end_section(msh_stream *s);
void msh_skip_section(msh_stream *s);

/* Fails if the rest of the file is too short for so many items, each of so many numbers (text) or bytes (binary). Call it before allocating memory
   for them. */
bool msh_fits(msh_stream *s, uint64_t count, int numbers, int bytes, const char *items);

#endif
