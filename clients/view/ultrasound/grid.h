/* The echo signal before beamforming: complex baseband amplitudes along scan lines, and the events that change the sound as it travels along a line. Only for
   this folder. */
#ifndef TROCAR_ULTRASOUND_GRID_H
#define TROCAR_ULTRASOUND_GRID_H

#include "view/ultrasound/beam.h"
#include "view/ultrasound/planes.h"

enum {
    GRID_LINES = 1024, GRID_ROWS = 4096, /* upper limits: a wider field gets a coarser line spacing, and an image ends at a depth of about 0.25 m */
    PAD = 8                  /* rows and lines around the image, for echoes that spread into it */
};

#define THICKNESS_CUT 2.2    /* nothing is seen beyond this many standard deviations of the beam's thickness */

typedef struct {
    int next;                /* next event in the same row, or -1 */
    int line;
    float once, each;        /* amplitude factors: at this row, and at every row from here on */
} sound_event;

typedef struct {
    image_field field;
    int rows, lines;         /* including PAD on each side */
    double step;             /* m, between rows */
    double spacing;          /* between lines: rad in a sector, otherwise m */
    double first_row;        /* m, distance of row 0 from the origin */
    double first_line;       /* position of line 0: rad in a sector, otherwise m */
    double wavelength;       /* m */
    float edge_cosine, edge_sine, edge_margin; /* outward normal (across, away) of the last line, and m beyond it from which echoes still reach the image */
    float *signal;           /* [rows][lines][2] */
    float *thickness;        /* [rows], m, standard deviation of the beam through the plane */
    float *mirror;           /* [rows], amplitude on each line of an echo from a perfect mirror perpendicular to the beam */

    sound_event *events;
    int event_count, event_room;
    int *event_head;         /* [rows], first event of each row, or -1 */
    float *first_event;      /* [lines], row of the line's first boundary */
    float *first_loss;       /* [lines], dB/(cm MHz), attenuation in front of that boundary */
} echo_grid;

/* A point relative to the image, in m: across, away from the probe, out of the plane. */
typedef struct {
    float u, v, w;
} image_point;

static inline image_point image_point_of(const image_plane *p, vec3 x) {
    vec3 from = v3_sub(x, p->origin);
    return (image_point){(float)v3_dot(from, p->axes[0]), (float)v3_dot(from, p->axes[1]), (float)v3_dot(from, p->axes[2])};
}

/* Return the row and the line of a point in the plane, as fractional numbers. */
static inline double grid_row(const echo_grid *g, double u, double v) {
    return ((g->field.sector ? hypot(u, v) : v) - g->first_row) / g->step;
}
static inline double grid_line(const echo_grid *g, double u, double v) {
    return ((g->field.sector ? atan2(u, v) : u) - g->first_line) / g->spacing;
}
/* Returns the distance (m) between neighbouring lines at a row. */
static inline double grid_line_distance(const echo_grid *g, double row) {
    return g->field.sector ? g->spacing * (g->first_row + row * g->step) : g->spacing;
}
/* Computes the direction in which sound travels along a line, as a unit vector (across, away). */
static inline void grid_beam(const echo_grid *g, double line, double *across, double *away) {
    double angle = g->field.sector ? g->first_line + line * g->spacing : 0;
    *across = sin(angle);
    *away = cos(angle);
}

/* Adds a real amplitude to a line. `row` may be fractional. */
void grid_add(echo_grid *g, int line, double row, double amplitude);

/* Changes the amplitude of everything from this row on: see sound_event. If there is no room, does nothing, and the image lacks a shadow. */
void grid_event(echo_grid *g, int line, double row, double once, double each);

#endif
