/* Writes a JSON document from front to back, commas and escapes included. `name` is that of an object's member, NULL within an
   array and for the document itself. */
#ifndef TROCAR_JSON_H
#define TROCAR_JSON_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "timing.h"

typedef struct {
    FILE *out;
    bool comma; /* before what comes next */
} json;

void json_open(json *j, const char *name, char bracket);     /* '{' or '[' */
void json_close(json *j, char bracket);                      /* '}' or ']' */
void json_text(json *j, const char *name, const char *text);
void json_number(json *j, const char *name, double value);   /* null if not finite: JSON has neither NaN nor infinity */
void json_numbers(json *j, const char *name, const double *values, int count);
void json_integer(json *j, const char *name, int64_t value);
void json_bool(json *j, const char *name, bool value);

/* What comes next begins a line, for documents that people read. */
void json_line(json *j);

void json_time(json *j, const histogram *time); /* members p50_s, p99_s and max_s of an object */

#endif
