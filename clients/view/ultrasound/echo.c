#include "view/ultrasound/echo.h"

#include <stdlib.h>
#include <string.h>

#include "view/ultrasound/scatterers.h"

enum { WIDEST_KERNEL = 24 }; /* most rows or lines on each side of a kernel's middle */

static const double ROWS_PER_SIGMA = 1.3;    /* rows per standard deviation of the pulse */
static const double LINES_PER_SIGMA = 1.3;   /* lines per standard deviation of the beam at its narrowest */
static const double MIRROR = 45;             /* dB, echo of a perfect mirror relative to the prostate's speckle; an assumption */
static const double COMPENSATED = 0.5;       /* dB/(cm MHz), attenuation that the scanner compensates for */
static const double SHARPEST = 0.3;          /* smallest standard deviation of a kernel, in rows or lines */

/* A Gaussian kernel: weights for offsets from -half to half rows or lines. */
typedef struct {
    int half;
    float weights[2 * WIDEST_KERNEL + 1];
} kernel;

/* Where a pixel lies in the envelope: the index of the point above and to the left of it, and the fraction of the way to the next points. */
typedef struct {
    int32_t at;              /* -1 outside the field */
    float down, right;
} lookup;

struct echo {
    const trocar_model *model;
    beam transducer;
    double density;
    reflectors reflectors;
    scatterers scatterers;
    image_point *nodes;
    echo_grid grid;
    kernel pulse, *widths;   /* `widths`: [rows], kernels for the beam's width */
    float *mixed, *loss, *factor; /* [2 * lines], [lines], [lines] */
    float *envelope;         /* [rows][lines] */
    image_raster raster;
    lookup *pixels;
};

trocar_status echo_create(const trocar_scene *scene, const trocar_model *model, const beam *transducer, double density, echo **created, trocar_error *why) {
    float amplitudes[32] = {0};
    echo *e = calloc(1, sizeof *e);
    if (!e) return fail(why, TROCAR_NO_MEMORY, "no memory for ultrasound images");
    *e = (echo){.model = model, .transducer = *transducer, .density = density};
    e->nodes = malloc((size_t)trocar_model_node_count(model) * sizeof *e->nodes);
    trocar_status status = e->nodes ? reflectors_create(&e->reflectors, scene, model, why) : fail(why, TROCAR_NO_MEMORY, "no memory for ultrasound images");
    for (int i = 0; i < 32; i++) amplitudes[i] = (float)pow(10, e->reflectors.volumes[i].backscatter / 20);
    if (status == TROCAR_OK) status = scatterers_create(&e->scatterers, model, density, amplitudes, why);
    if (status == TROCAR_OK) *created = e;
    else echo_free(e);
    return status;
}

static void free_frame(echo *e) {
    echo_grid *g = &e->grid;
    void *const all[] = {g->signal, g->thickness, g->mirror, g->events, g->event_head, g->first_event, g->first_loss, e->widths, e->mixed, e->loss, e->factor, e->envelope, e->pixels};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
    e->grid = (echo_grid){.rows = 0};
    e->widths = NULL;
    e->mixed = e->loss = e->factor = e->envelope = NULL;
    e->pixels = NULL;
}

void echo_free(echo *e) {
    free_frame(e);
    reflectors_free(&e->reflectors);
    scatterers_free(&e->scatterers);
    free(e->nodes);
    free(e);
}

/* ---- what the image covers ---- */

/* Returns a Gaussian kernel. It is narrower than `sigma`, because distributing an echo linearly over neighbouring points already adds a variance of 1/6. */
static kernel kernel_of(double sigma) {
    kernel k = {.half = 0};
    double own = fmax(SHARPEST, sqrt(fmax(0, sigma * sigma - 1.0 / 6)));
    k.half = (int)fmin(WIDEST_KERNEL, ceil(3 * own));
    for (int i = -k.half; i <= k.half; i++) k.weights[i + k.half] = (float)exp(-0.5 * i * i / (own * own));
    return k;
}

/* Returns the mean energy of the kernel applied to a linearly distributed echo. The integral of the product of two triangle functions is 2/3 at distance 0 and
   1/6 at distance 1. */
static double energy_of(const kernel *k) {
    double sum = 0;
    for (int i = 0; i <= 2 * k->half; i++) sum += k->weights[i] * (2 * k->weights[i] + (i < 2 * k->half ? k->weights[i + 1] : 0)) / 3;
    return sum;
}

static double sum_of(const kernel *k) {
    double sum = 0;
    for (int i = 0; i <= 2 * k->half; i++) sum += k->weights[i];
    return sum;
}

/* Computes a row's kernel. Its scale makes the mean intensity of the prostate's speckle 1 at all depths, as a scanner's depth gain does. */
static void prepare_row(echo *e, int row) {
    echo_grid *g = &e->grid;
    double depth = fmax(0, (row - PAD) * g->step), apart = grid_line_distance(g, fmax(row, PAD));
    kernel *k = &e->widths[row];
    g->thickness[row] = (float)beam_thickness_sigma(&e->transducer, depth);
    *k = kernel_of(beam_width_sigma(&e->transducer, depth) / apart);
    double scatterers = e->density * g->step * apart * sqrt(M_PI) * g->thickness[row] * erf(THICKNESS_CUT);
    double scale = 1 / sqrt(scatterers * energy_of(&e->pulse) * energy_of(k));
    for (int i = 0; i <= 2 * k->half; i++) k->weights[i] *= (float)scale;
    g->mirror[row] = (float)(pow(10, MIRROR / 20) / (sum_of(k) * e->pulse.weights[e->pulse.half]));
}

/* Prepares the conversion from the envelope to pixels. */
static void prepare_pixels(echo *e) {
    const echo_grid *g = &e->grid;
    const image_raster *r = &e->raster;
    for (int j = 0; j < r->height; j++)
        for (int i = 0; i < r->width; i++) {
            double u = r->left + i * r->pixel, v = r->near + j * r->pixel, row = grid_row(g, u, v), line = grid_line(g, u, v);
            bool seen = row >= PAD && row < g->rows - PAD - 1 && line >= PAD && line < g->lines - PAD - 1 && v > 0;
            e->pixels[j * r->width + i] = seen ? (lookup){(int)row * g->lines + (int)line, (float)(row - floor(row)), (float)(line - floor(line))} : (lookup){-1, 0, 0};
        }
}

trocar_status echo_frame(echo *e, const image_field *field, const image_raster *raster, trocar_error *why) {
    free_frame(e);
    echo_grid *g = &e->grid;
    const beam *b = &e->transducer;
    double narrowest = beam_width_sigma(b, b->focus) / LINES_PER_SIGMA;
    *g = (echo_grid){.field = *field, .wavelength = beam_wavelength(b), .step = beam_pulse_sigma(b) / ROWS_PER_SIGMA};
    g->spacing = fmax(field->sector ? narrowest / (field->face + b->focus) : narrowest, 2 * field->side / (GRID_LINES - 2 * PAD - 2));
    g->rows = 2 * PAD + 1 + (int)fmin(ceil(fmax(field->far - field->face, 0) / g->step), GRID_ROWS - 2 * PAD - 1);
    g->lines = 2 * PAD + 1 + (int)ceil(2 * field->side / g->spacing);
    g->first_row = field->face - PAD * g->step;
    g->first_line = field->centre - 0.5 * (g->lines - 1) * g->spacing;
    g->edge_cosine = field->sector ? (float)cos(field->side) : 1;
    g->edge_sine = field->sector ? (float)sin(field->side) : 0;
    g->edge_margin = (float)(PAD * grid_line_distance(g, g->rows) + (field->sector ? 0 : field->side));
    g->event_room = 64 * g->lines;
    size_t points = (size_t)g->rows * (size_t)g->lines, pixels = (size_t)raster->width * (size_t)raster->height;
    g->signal = malloc(2 * points * sizeof *g->signal);
    g->thickness = malloc((size_t)g->rows * sizeof *g->thickness);
    g->mirror = malloc((size_t)g->rows * sizeof *g->mirror);
    g->events = malloc((size_t)g->event_room * sizeof *g->events);
    g->event_head = malloc((size_t)g->rows * sizeof *g->event_head);
    g->first_event = malloc((size_t)g->lines * sizeof *g->first_event);
    g->first_loss = malloc((size_t)g->lines * sizeof *g->first_loss);
    e->widths = malloc((size_t)g->rows * sizeof *e->widths);
    e->mixed = malloc(2 * (size_t)g->lines * sizeof *e->mixed);
    e->loss = malloc((size_t)g->lines * sizeof *e->loss);
    e->factor = malloc((size_t)g->lines * sizeof *e->factor);
    e->envelope = malloc(points * sizeof *e->envelope);
    e->pixels = malloc(pixels * sizeof *e->pixels);
    if (!g->signal || !g->thickness || !g->mirror || !g->events || !g->event_head || !g->first_event || !g->first_loss || !e->widths || !e->mixed || !e->loss || !e->factor
        || !e->envelope || !e->pixels) return fail(why, TROCAR_NO_MEMORY, "no memory for ultrasound images of %d x %d pixels", raster->width, raster->height);
    e->raster = *raster;
    e->pulse = kernel_of(beam_pulse_sigma(b) / g->step);
    for (int row = 0; row < g->rows; row++) prepare_row(e, row);
    prepare_pixels(e);
    return TROCAR_OK;
}

/* ---- the signal ---- */

void grid_add(echo_grid *g, int line, double row, double amplitude) {
    if (!(row >= 0 && row < g->rows - 1)) return;
    int above = (int)row;
    float *at = g->signal + 2 * ((size_t)above * (size_t)g->lines + (size_t)line), part = (float)(row - above), size = (float)amplitude * g->mirror[above];
    at[0] += size * (1 - part);
    at[2 * (size_t)g->lines] += size * part;
}

/* The event takes effect behind the echo, which is distributed over the rows before and after `row`. */
void grid_event(echo_grid *g, int line, double row, double once, double each) {
    int at = (int)fmin(fmax(row, -2), g->rows) + 2;
    if (at >= g->rows || g->event_count == g->event_room) return;
    g->events[g->event_count] = (sound_event){g->event_head[at], line, (float)once, (float)each};
    g->event_head[at] = g->event_count++;
}

static void clear(echo *e) {
    echo_grid *g = &e->grid;
    memset(g->signal, 0, 2 * (size_t)g->rows * (size_t)g->lines * sizeof *g->signal);
    memset(g->event_head, -1, (size_t)g->rows * sizeof *g->event_head);
    g->event_count = 0;
    for (int l = 0; l < g->lines; l++) g->first_event[l] = INFINITY, g->first_loss[l] = (float)COMPENSATED;
}

/* Attenuates the signal row by row, by what exceeds the attenuation that the scanner compensates for. */
static void attenuate(echo *e) {
    echo_grid *g = &e->grid;
    for (int l = 0; l < g->lines; l++) {
        e->factor[l] = 1;
        e->loss[l] = (float)sound_left(g->first_loss[l] - COMPENSATED, e->transducer.frequency, g->step);
    }
    for (int row = 0; row < g->rows; row++) {
        float *restrict signal = g->signal + 2 * (size_t)row * (size_t)g->lines, *restrict factor = e->factor;
        for (int i = g->event_head[row]; i >= 0; i = g->events[i].next) {
            const sound_event *event = &g->events[i];
            factor[event->line] *= event->once;
            e->loss[event->line] *= event->each;
        }
        for (int l = 0; l < g->lines; l++) {
            if (row > PAD) factor[l] *= e->loss[l]; /* nothing is lost in front of the face */
            signal[2 * l] *= factor[l];
            signal[2 * l + 1] *= factor[l];
        }
    }
}

/* ---- the beam ---- */

/* Convolves the signal with the pulse and the beam width. Within PAD rows and lines of the edges, the result is incomplete. */
static void form_beam(echo *e) {
    const echo_grid *g = &e->grid;
    int wide = 2 * g->lines;
    for (int row = 0; row < g->rows; row++) {
        float *restrict mixed = e->mixed;
        memset(mixed, 0, (size_t)wide * sizeof *mixed);
        for (int k = -e->pulse.half; k <= e->pulse.half; k++) {
            if (row + k < 0 || row + k >= g->rows) continue;
            const float *restrict signal = g->signal + (size_t)(row + k) * (size_t)wide;
            float weight = e->pulse.weights[k + e->pulse.half];
            for (int i = 0; i < wide; i++) mixed[i] += weight * signal[i];
        }
        const kernel *across = &e->widths[row];
        static _Thread_local float formed[2 * GRID_LINES];
        memset(formed, 0, (size_t)wide * sizeof *formed);
        for (int k = -across->half; k <= across->half; k++) {
            int from = k < 0 ? -2 * k : 0, to = k > 0 ? wide - 2 * k : wide;
            float weight = across->weights[k + across->half];
            for (int i = from; i < to; i++) formed[i] += weight * mixed[i + 2 * k];
        }
        float *restrict envelope = e->envelope + (size_t)row * (size_t)g->lines;
        for (int l = 0; l < g->lines; l++) envelope[l] = sqrtf(formed[2 * l] * formed[2 * l] + formed[2 * l + 1] * formed[2 * l + 1]);
    }
}

/* ---- pixels ---- */

/* Converts an amplitude to decibels, using its exponent and a polynomial for the logarithm of the mantissa. The error is below 0.05 dB. */
static inline float decibels(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    float exponent = (float)((int)(bits >> 23) - 127), m;
    bits = (bits & 0x7fffffu) | 0x3f800000u;
    memcpy(&m, &bits, sizeof m);
    return 6.0206f * (exponent - 2.1536207f + m * (3.0478842f + m * (-1.0518750f + 0.1582488f * m)));
}

/* Averages over three rows, because pixels are larger than rows, then interpolates and takes the logarithm. */
static void convert(const echo *e, unsigned char *levels) {
    const int lines = e->grid.lines;
    const size_t count = (size_t)e->raster.width * (size_t)e->raster.height;
    for (size_t p = 0; p < count; p++) {
        lookup l = e->pixels[p];
        const float *at = e->envelope + (l.at < 0 ? lines : l.at), down = l.down, right = l.right;
        float weights[4] = {0.25f * (1 - down), 0.5f - 0.25f * down, 0.25f + 0.25f * down, 0.25f * down}, sum = 1e-6f;
        for (int k = 0; k < 4; k++) sum += weights[k] * (at[(k - 1) * lines] * (1 - right) + at[(k - 1) * lines + 1] * right);
        float level = 1.5f + (decibels(sum) - (float)ECHO_FLOOR) * (float)(1 / ECHO_STEP);
        levels[p] = l.at < 0 ? 0 : (unsigned char)fminf(fmaxf(level, 1), 255);
    }
}

void echo_image(echo *e, const image_plane *plane, const double *nodes, const echo_body *bodies, int body_count, unsigned char *levels) {
    for (int i = 0; i < trocar_model_node_count(e->model); i++)
        e->nodes[i] = image_point_of(plane, v3(nodes[3 * (size_t)i], nodes[3 * (size_t)i + 1], nodes[3 * (size_t)i + 2]));
    clear(e);
    scatterers_add(&e->scatterers, e->nodes, &e->grid);
    reflectors_add(&e->reflectors, e->nodes, e->transducer.frequency, &e->grid);
    for (int i = 0; i < body_count; i++) reflectors_add_body(plane, &bodies[i], &e->grid);
    attenuate(e);
    form_beam(e);
    convert(e, levels);
}

void echo_show(unsigned char *levels, size_t count, double gain, double range) {
    unsigned char grey[256] = {0};
    for (int level = 1; level < 256; level++) {
        double brightness = ECHO_FLOOR + (level - 1) * ECHO_STEP + gain;
        grey[level] = (unsigned char)(0.5 + 255 * fmin(fmax(1 + (brightness - ECHO_WHITE) / range, 0), 1));
    }
    for (size_t i = 0; i < count; i++) levels[i] = grey[levels[i]];
}

echo_envelope echo_last(const echo *e) {
    const echo_grid *g = &e->grid;
    return (echo_envelope){g->rows, g->lines, g->step, g->first_row, g->spacing, g->first_line, e->envelope};
}
