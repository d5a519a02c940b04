/* A seed model: the TG-43 data of one kind of brachytherapy source, as read from its table. */
#ifndef TROCAR_DOSE_SOURCE_H
#define TROCAR_DOSE_SOURCE_H

#include "base/report.h"

enum { MAX_TABLE_RADII = 64, MAX_TABLE_ANGLES = 181, SOURCE_NAME = 64, MAX_PIECES_OF_R = 1 + 2 * MAX_TABLE_RADII };

/* F = a + b angle + r (c + d angle) between two radii and two angles. */
typedef struct { double a, b, c, d; } anisotropy_cell;

/* Constant once it is read. Lengths in cm, as TG-43 has them; angles in degrees. */
struct trocar_dose_source {
    char name[SOURCE_NAME];
    double dose_rate_constant;   /* cGy/(h U) */
    double active_length;
    double half_life;            /* days */
    double capsule_length, capsule_diameter;

    /* Pieces between the radii of both tables: start[i] <= r < start[i + 1]; the first one starts at 0, the last one goes on without end.
       log g = intercept + slope r. */
    int piece_count;
    double start[MAX_PIECES_OF_R], intercept[MAX_PIECES_OF_R], slope[MAX_PIECES_OF_R];

    /* F between angles from 0 to 180; a table that ends at 90 is mirrored. */
    int angle_count;
    double angle[2 * MAX_TABLE_ANGLES];
    anisotropy_cell *cells;      /* [piece_count][angle_count - 1] */
};

/* Reads a table into memory that need not be set. `file` is for messages. BAD_INPUT with file, line and remedy; NO_MEMORY. Only after success
   is dose_source_clear due. */
trocar_status dose_source_read(const char *file, const char *text, size_t length, trocar_dose_source *s, report *why);

void dose_source_clear(trocar_dose_source *s);

/* The tables in data/, in alphabetical order; the last entry is NULL. Made by CMake. */
typedef struct { const char *name, *file, *text; } dose_table;
extern const dose_table DOSE_TABLES[];

#endif
