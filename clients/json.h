/* Pieces of JSON, for the benchmarks' results. */
#ifndef TROCAR_JSON_H
#define TROCAR_JSON_H

#include <stdio.h>

#include "timing.h"

void json_string(const char *text, FILE *out);           /* quoted and escaped */
void json_time(const histogram *time, FILE *out);        /* members p50_s, p99_s and max_s of an object */

#endif
