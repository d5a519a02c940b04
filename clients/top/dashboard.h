/* The display of trocar-top: shows the newest timing and status of a server as lines of text. The code uses no terminal, no network and no clock. */
#ifndef TROCAR_DASHBOARD_H
#define TROCAR_DASHBOARD_H

#include <stdbool.h>

#include "shared/server_choice.h"
#include "trocar.h"
#include "trocar_loop_timing_t.h"
#include "trocar_status_t.h"

enum { DASHBOARD_BINS = 32, DASHBOARD_LINES = 64, DASHBOARD_WIDTH = 160 };

/* State of the display. All zero at the start. */
typedef struct {
    server_choice servers;                       /* only the server that is followed is shown */
    bool heard;                                  /* true once a timing message has arrived */
    double heard_at;                             /* s, arrival time of the newest timing message */
    trocar_loop_timing_t timing;                 /* the newest timing message */
    int64_t first_misses;                        /* number of missed periods before the first timing message; these raise no alarm */
    double lateness[DASHBOARD_BINS], compute[DASHBOARD_BINS]; /* histogram counts since the start or the last reset */
    trocar_status_t needles[TROCAR_MAX_NEEDLES]; /* newest status of each needle, without its strings */
    int needle_count;                            /* number of needles in the server's scene; 0 before the first status */
    char scene[96], message[DASHBOARD_WIDTH];    /* strings of the newest status */
    int64_t foreign;                             /* number of messages that could not be decoded */
} dashboard;

typedef struct {
    char text[DASHBOARD_WIDTH];
    bool alarm;                                  /* the line reports a condition that needs attention */
} dashboard_line;

/* Takes a message that arrived at the time `now` (s). */
void dashboard_take_timing(dashboard *d, const trocar_loop_timing_t *timing, double now);
void dashboard_take_status(dashboard *d, const trocar_status_t *status, double now);
void dashboard_clear(dashboard *d);              /* empties the histograms */

/* Fills in the lines for the time `now` (s, the clock of take_timing) and a screen of `height` lines, with the histograms at the bottom as high as
   the screen allows. Returns the number of lines, which exceeds neither `height` nor DASHBOARD_LINES. A line fits in 72 columns. */
int dashboard_draw(const dashboard *d, double now, int height, dashboard_line lines[DASHBOARD_LINES]);

#endif
