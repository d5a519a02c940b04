/* Writes a JSON document piece by piece, with commas and escapes. `name` is the name of an object's member; pass NULL in arrays and for the document itself. */
#ifndef TROCAR_JSON_H
#define TROCAR_JSON_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "base/vec.h"
#include "common/timing.h"

typedef struct {
    FILE *out;
    bool comma; /* the next value needs a comma before it */
} json;

void json_open(json *j, const char *name, char bracket);     /* '{' or '[' */
void json_close(json *j, char bracket);                      /* '}' or ']' */
void json_text(json *j, const char *name, const char *text);
void json_number(json *j, const char *name, double value);   /* writes null if the value is not finite, because JSON has neither NaN nor infinity */
void json_exact(json *j, const char *name, double value);    /* writes all digits, so that the same double is read back; null if not finite */
void json_xyz(json *j, const char *name, vec3 v);            /* writes an object with members x, y and z, with all digits */
void json_time_stamp(json *j, double time);                  /* writes the member "timestamp" in s, to the microsecond */
void json_numbers(json *j, const char *name, const double *values, int count);
void json_integer(json *j, const char *name, int64_t value);
void json_bool(json *j, const char *name, bool value);

/* Starts a new line before the next value, for readability. */
void json_line(json *j);

void json_time(json *j, const histogram *time); /* writes the members p50_s, p99_s and max_s into the current object */

#endif
