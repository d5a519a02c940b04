/* Rows of the verification results. A check is a program `verify_NAME [--short] FOLDER` that writes FOLDER/NAME.json:

       int main(int argc, char **argv) {
           rows r = rows_begin(argc, argv, "Needle: bending");
           rows_compare(&r, "tip deflection", "P L^3 / 3 E I", deflection, expected, 1e-3, "m");
           return rows_end(&r);
       }

   rows_measured() writes a value without a limit, which neither passes nor fails and is not counted. A section has the form "Part: subject", by which the
   report is sorted. tests/verification/rows.py is the Python version. */
#ifndef TROCAR_VERIFICATION_ROWS_H
#define TROCAR_VERIFICATION_ROWS_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "shared/json.h"

typedef struct {
    const char *section;       /* section of the rows that follow; may be changed between rows */
    const char *folder;        /* for output; exists */
    bool short_form;           /* if --short was given, so that the check must take no more than a few seconds */
    json file;
    int failed;
} rows;

/* One line of the report. It passes if error <= limit. */
typedef struct {
    const char *check;         /* quantity and case */
    const char *reference;     /* compared with */
    double value;
    double expected;           /* NAN: none */
    double error, limit;       /* relative error, unless the note says otherwise */
    const char *unit;          /* of value and expected value, or NULL if they have none */
    const char *note;          /* why the row failed, or a comment; NULL for none */
} row;

/* A curve in a figure. Curves with the same figure name go into FIGURE.svg; those with the same label have the same colour. */
typedef struct {
    const char *figure;        /* file name without .svg */
    const char *label, *x_label, *y_label;
    bool logarithmic;          /* both axes */
    int count;
    const double *x, *y;       /* count */
} curve;

static inline rows rows_begin(int argc, char **argv, const char *section) {
    rows r = {.section = section, .short_form = argc == 3 && strcmp(argv[1], "--short") == 0};
    if (argc != 2 + r.short_form || argv[argc - 1][0] == '-') {
        fprintf(stderr, "usage: %s [--short] FOLDER\n", argv[0]);
        exit(2);
    }
    r.folder = argv[argc - 1];
    const char *slash = strrchr(argv[0], '/'), *name = slash ? slash + 1 : argv[0];
    if (strncmp(name, "verify_", 7) == 0) name += 7;
    char path[4096];
    snprintf(path, sizeof path, "%s/%s.json", r.folder, name);
    r.file.out = fopen(path, "w");
    if (!r.file.out) {
        perror(path);
        exit(2);
    }
    json_open(&r.file, NULL, '[');
    return r;
}

static inline void rows_text(rows *r, const char *key, const char *text) { json_text(&r->file, key, text ? text : ""); }

/* Begins the next entry. */
static inline void rows_open(rows *r, const char *kind) {
    json_line(&r->file);
    json_open(&r->file, NULL, '{');
    rows_text(r, "kind", kind);
    rows_text(r, "section", r->section);
}

static inline void rows_values(rows *r, const char *kind, const row *entry) {
    rows_open(r, kind);
    rows_text(r, "check", entry->check);
    rows_text(r, "reference", entry->reference);
    json_number(&r->file, "value", entry->value);
    json_number(&r->file, "expected", entry->expected);
    json_number(&r->file, "error", entry->error);
    rows_text(r, "unit", entry->unit);
    rows_text(r, "note", entry->note);
}

static inline void rows_add(rows *r, row entry) {
    bool pass = entry.error <= entry.limit; /* false for NaN */
    r->failed += !pass;
    rows_values(r, "row", &entry);
    json_number(&r->file, "limit", entry.limit);
    json_bool(&r->file, "pass", pass);
    json_close(&r->file, '}');
    printf("%s  %s: %.6g%s%s (error %.3g, limit %.3g)\n", pass ? "pass" : "FAIL", entry.check, entry.value,
           entry.unit ? " " : "", entry.unit ? entry.unit : "", entry.error, entry.limit);
    fflush(stdout);
}

/* Writes a row without a limit, ignoring entry.limit. */
static inline void rows_measured(rows *r, row entry) {
    rows_values(r, "measured", &entry);
    json_close(&r->file, '}');
    printf("      %s: %.6g%s%s (error %.3g, no limit)\n", entry.check, entry.value, entry.unit ? " " : "", entry.unit ? entry.unit : "", entry.error);
    fflush(stdout);
}

/* Compares a value with the expected one by relative error. */
static inline void rows_compare(rows *r, const char *check, const char *reference, double value, double expected,
                                double limit, const char *unit) {
    rows_add(r, (row){.check = check, .reference = reference, .value = value, .expected = expected,
                      .error = fabs(value - expected) / fabs(expected), .limit = limit, .unit = unit});
}

/* Writes a row whose value is itself an error. */
static inline void rows_error(rows *r, const char *check, const char *reference, double error, double limit) {
    rows_add(r, (row){.check = check, .reference = reference, .value = error, .expected = NAN, .error = fabs(error), .limit = limit});
}

static inline void rows_curve(rows *r, curve c) {
    rows_open(r, "curve");
    rows_text(r, "figure", c.figure);
    rows_text(r, "label", c.label);
    rows_text(r, "x_label", c.x_label);
    rows_text(r, "y_label", c.y_label);
    json_bool(&r->file, "logarithmic", c.logarithmic);
    json_numbers(&r->file, "x", c.x, c.count);
    json_numbers(&r->file, "y", c.y, c.count);
    json_close(&r->file, '}');
}

/* Returns the program's exit status: 0 if every row passed, 1 otherwise. */
static inline int rows_end(rows *r) {
    json_close(&r->file, ']');
    fputc('\n', r->file.out);
    bool written = fclose(r->file.out) == 0;
    if (!written) perror(r->folder);
    return written && r->failed == 0 ? 0 : 1;
}

#endif
