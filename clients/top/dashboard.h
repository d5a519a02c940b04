/* The display of trocar-top: a server's newest timing and status as lines of text. No terminal, no network, no clock. */
#ifndef TROCAR_DASHBOARD_H
#define TROCAR_DASHBOARD_H

#include <stdbool.h>

#include "shared/server_choice.h"
#include "trocar.h"
#include "trocar_loop_timing_t.h"
#include "trocar_status_t.h"

enum { DASHBOARD_BINS = 32, DASHBOARD_LINES = 64, DASHBOARD_WIDTH = 160 };

/* All zero at the start. */
typedef struct {
    server_choice servers;                       /* only the server that is followed is shown */
    bool heard;                                  /* a timing has arrived */
    double heard_at;                             /* s, arrival of the newest timing */
    trocar_loop_timing_t timing;                 /* the newest */
    int64_t first_misses;                        /* misses before the first timing, which raise no alarm */
    double lateness[DASHBOARD_BINS], compute[DASHBOARD_BINS]; /* counts since the start or the last reset */
    trocar_status_t needles[TROCAR_MAX_NEEDLES]; /* newest status of each needle, without its strings */
    int needle_count;                            /* of the server's scene; 0 before the first status */
    char scene[96], message[DASHBOARD_WIDTH];    /* strings of the newest status */
    int64_t foreign;                             /* messages that could not be decoded */
} dashboard;

typedef struct {
    char text[DASHBOARD_WIDTH];
    bool alarm;                                  /* needs attention */
} dashboard_line;

/* Takes a message that arrived at `now`, s. */
void dashboard_take_timing(dashboard *d, const trocar_loop_timing_t *timing, double now);
void dashboard_take_status(dashboard *d, const trocar_status_t *status, double now);
void dashboard_clear(dashboard *d);              /* empties the histograms */

/* Fills in the lines for the time `now` (s, the clock of take_timing) and a screen of `height` lines, with the histograms at the bottom as high as
   fits. Returns the number of lines, at most `height` (and DASHBOARD_LINES). A line fits in 72 columns. */
int dashboard_draw(const dashboard *d, double now, int height, dashboard_line lines[DASHBOARD_LINES]);

#endif
