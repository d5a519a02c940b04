/* Shared by players and bridges: ending on a signal, real time. */
#ifndef TROCAR_PLAYING_H
#define TROCAR_PLAYING_H

#include <stdbool.h>

/* From now on SIGINT and SIGTERM only make playing_interrupted() true. */
void playing_heed_signals(void);
bool playing_interrupted(void);

/* Puts the calling thread under SCHED_FIFO; threads that it creates inherit that. If this is refused: false, and a note on stderr. */
bool playing_use_realtime(void);

double playing_now(void); /* s, monotonic */

#endif
