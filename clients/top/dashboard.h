/* What trocar-top shows: a server's newest timing and status as lines of text. Does not touch the terminal, the network or the clock. */
#ifndef TROCAR_DASHBOARD_H
#define TROCAR_DASHBOARD_H

#include <stdbool.h>

#include "shared/server_choice.h"
#include "trocar.h"
#include "trocar_loop_timing_t.h"
#include "trocar_status_t.h"

enum { DASHBOARD_BINS = 32, DASHBOARD_LINES = 64, DASHBOARD_WIDTH = 160 };

/* State of the display. Start with all zero. */
typedef struct {
    server_choice servers;                       /* chooses the server to show */
    bool heard;                                  /* true once a timing message has arrived */
    double heard_at;                             /* s, when the newest timing message arrived */
    trocar_loop_timing_t timing;                 /* the newest timing message */
    int64_t first_misses;                        /* periods missed before the first timing message; these raise no alarm */
    double lateness[DASHBOARD_BINS], compute[DASHBOARD_BINS]; /* histograms since the start or the last reset */
    trocar_status_t needles[TROCAR_MAX_NEEDLES]; /* newest status of each needle, without its strings */
    int needle_count;                            /* in the server's scene; 0 before the first status */
    char scene[96], message[DASHBOARD_WIDTH];    /* from the newest status */
    int64_t foreign;                             /* messages that could not be decoded */
} dashboard;

typedef struct {
    char text[DASHBOARD_WIDTH];
    bool alarm;                                  /* the line reports something that needs attention */
} dashboard_line;

/* Takes a message that arrived at time `now` (s). */
void dashboard_take_timing(dashboard *d, const trocar_loop_timing_t *timing, double now);
void dashboard_take_status(dashboard *d, const trocar_status_t *status, double now);
void dashboard_clear(dashboard *d);              /* empties the histograms */

/* Writes the lines to show at time `now` (s, by the clock of take_timing) on a screen of `height` lines. The histograms at the bottom are as high as the screen
   allows. Returns the number of lines, at most `height` and DASHBOARD_LINES. Every line fits in 72 columns. */
int dashboard_draw(const dashboard *d, double now, int height, dashboard_line lines[DASHBOARD_LINES]);

#endif
