/* Functions shared by players and bridges: they handle signals that end the program, and real-time scheduling. */
#ifndef TROCAR_PLAYING_H
#define TROCAR_PLAYING_H

#include <stdbool.h>

/* After this call, SIGINT and SIGTERM do not end the process but make playing_interrupted() true. */
void playing_heed_signals(void);
bool playing_interrupted(void);

/* Schedules the calling thread by SCHED_FIFO; threads that it creates inherit that. If permission is refused, returns false and prints a note on
   stderr. */
bool playing_use_realtime(void);

double playing_now(void); /* s, monotonic */

#endif
