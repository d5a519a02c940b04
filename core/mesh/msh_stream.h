/* Reads numbers and words from an MSH file, which may be text, or binary in either byte order. The first failure writes a message with the line or byte. From
   then on, all functions return 0 and the message is kept. */
#ifndef TROCAR_MSH_STREAM_H
#define TROCAR_MSH_STREAM_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"

enum { MSH_WORD = 64 };

typedef struct {
    FILE *file;
    const char *path;        /* for messages */
    bool converted;          /* true if `file` was converted from `path`, so messages cannot give a line or byte */
    trocar_error *why;
    trocar_status status;
    uint64_t size;           /* size of the file in bytes */
    uint64_t line, word_line; /* numbers, from 1, of the current line and of the last word's line; counted only in parts that are read as text */
    bool binary, swapped;    /* whether numbers are binary, and in the other byte order; known once $MeshFormat has been read */
    char section[MSH_WORD];  /* name of the section without $; empty before the first section */
} msh_stream;

/* Reports a failure, prefixing the message with "file:line: " or "file: byte n: ". Returns BAD_INPUT. If there was an earlier failure, keeps its message and
   returns its status. */
__attribute__((format(printf, 2, 3))) trocar_status msh_fail(msh_stream *s, const char *format, ...);

/* Read a number. In text, numbers are separated by blanks or line ends; in binary, they take 4, 8 and 8 bytes, respectively. */
int msh_int(msh_stream *s);
uint64_t msh_size(msh_stream *s);
double msh_real(msh_stream *s);

/* Read an integer that is text even in a binary file. The second function also skips the rest of the line. */
int64_t msh_text_int(msh_stream *s);
int64_t msh_text_int_line(msh_stream *s);

/* Reads a real number in text form. */
double msh_text_real(msh_stream *s);

/* Reads the text between double quotes in the rest of this line, or "" if there are none. Truncates it to `room` - 1 characters. */
void msh_quoted(msh_stream *s, char *text, size_t room);

/* Reads a binary file's byte-order mark: the number 1 in 4 bytes. */
void msh_byte_order(msh_stream *s);

/* Skips to the next line that begins with $ and sets `section`. Returns false at the end of the file or after a failure. */
bool msh_next_section(msh_stream *s);

/* msh_end_section reads the line $End..., which must be next; msh_skip_section also skips all lines before it. */
void msh_end_section(msh_stream *s);
void msh_skip_section(msh_stream *s);

/* Call this before allocating memory for items. Fails if the rest of the file is too short for this many, each taking `numbers` numbers (text) or `bytes` bytes
   (binary). */
bool msh_fits(msh_stream *s, uint64_t count, int numbers, int bytes, const char *items);

#endif
