/* A seed model: the TG-43 data of one kind of brachytherapy source, as read from its table. */
#ifndef TROCAR_DOSE_SOURCE_H
#define TROCAR_DOSE_SOURCE_H

#include "base/report.h"

enum { MAX_TABLE_RADII = 64, MAX_TABLE_ANGLES = 181, SOURCE_NAME = 64 };

/* Constant once it is read. Lengths in cm, as TG-43 has them; angles in degrees. */
struct trocar_dose_source {
    char name[SOURCE_NAME];
    double dose_rate_constant;   /* cGy/(h U) */
    double active_length;
    double half_life;            /* days */
    double capsule_length, capsule_diameter;

    /* g(r): piecewise log_g = intercept + slope r. Piece 0 lies before the first radius and is constant; the last one begins at the
       last radius but one and goes on beyond the table. Piece i > 0 begins at start[i]. */
    int piece_count;
    double start[MAX_TABLE_RADII], intercept[MAX_TABLE_RADII], slope[MAX_TABLE_RADII];

    /* F(r, angle), angles from 0 to 180: a table that ends at 90 is mirrored. */
    int radius_count, angle_count;
    double radius[MAX_TABLE_RADII], angle[2 * MAX_TABLE_ANGLES];
    double f[MAX_TABLE_RADII][2 * MAX_TABLE_ANGLES];
};

/* Reads a table. `file` is for messages. BAD_INPUT with file, line and remedy; NO_MEMORY. */
trocar_status dose_source_read(const char *file, const char *text, size_t length, trocar_dose_source *s, report *why);

/* The tables in data/, in alphabetical order; the last entry is NULL. Made by CMake. */
typedef struct { const char *name, *file, *text; } dose_table;
extern const dose_table DOSE_TABLES[];

#endif
