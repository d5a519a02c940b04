/* What players and bridges have in common: termination signals, real-time scheduling and the clock. */
#ifndef TROCAR_PLAYING_H
#define TROCAR_PLAYING_H

#include <stdbool.h>

/* Makes SIGINT and SIGTERM set playing_interrupted() instead of ending the process. */
void playing_heed_signals(void);
bool playing_interrupted(void);

/* Runs the calling thread, and threads it creates later, under SCHED_FIFO. If that is not permitted, returns false and says so on stderr. */
bool playing_use_realtime(void);

double playing_now(void); /* s, monotonic */

#endif
