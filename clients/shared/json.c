#include "shared/json.h"

#include <inttypes.h>
#include <math.h>

static void string(const char *text, FILE *out) {
    fputc('"', out);
    for (const unsigned char *c = (const unsigned char *)text; *c; c++) {
        if (*c < ' ' || *c == '"' || *c == '\\') fprintf(out, "\\u%04x", *c);
        else fputc(*c, out);
    }
    fputc('"', out);
}

static void begin(json *j, const char *name) {
    if (j->comma) fputs(", ", j->out);
    j->comma = true;
    if (!name) return;
    string(name, j->out);
    fputs(": ", j->out);
}

void json_open(json *j, const char *name, char bracket) {
    begin(j, name);
    fputc(bracket, j->out);
    j->comma = false;
}

void json_close(json *j, char bracket) {
    fputc(bracket, j->out);
    j->comma = true;
}

void json_text(json *j, const char *name, const char *text) {
    begin(j, name);
    string(text, j->out);
}

static void number(json *j, const char *name, int digits, double value) {
    begin(j, name);
    if (isfinite(value)) fprintf(j->out, "%.*g", digits, value);
    else fputs("null", j->out);
}

void json_number(json *j, const char *name, double value) { number(j, name, 12, value); }
void json_exact(json *j, const char *name, double value) { number(j, name, 17, value); }

void json_xyz(json *j, const char *name, vec3 v) {
    json_open(j, name, '{');
    json_exact(j, "x", v.x);
    json_exact(j, "y", v.y);
    json_exact(j, "z", v.z);
    json_close(j, '}');
}

void json_time_stamp(json *j, double time) {
    begin(j, "timestamp");
    fprintf(j->out, "%.6f", time);
}

void json_numbers(json *j, const char *name, const double *values, int count) {
    json_open(j, name, '[');
    for (int i = 0; i < count; i++) json_number(j, NULL, values[i]);
    json_close(j, ']');
}

void json_integer(json *j, const char *name, int64_t value) {
    begin(j, name);
    fprintf(j->out, "%" PRId64, value);
}

void json_bool(json *j, const char *name, bool value) {
    begin(j, name);
    fputs(value ? "true" : "false", j->out);
}

void json_line(json *j) {
    fputs(j->comma ? ",\n  " : "\n  ", j->out);
    j->comma = false;
}

void json_time(json *j, const histogram *time) {
    json_number(j, "p50_s", histogram_quantile(time, 0.5));
    json_number(j, "p99_s", histogram_quantile(time, 0.99));
    json_number(j, "max_s", histogram_max(time));
}
