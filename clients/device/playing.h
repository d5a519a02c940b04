/* Functions shared by players and bridges: termination signals, real-time scheduling and the clock. */
#ifndef TROCAR_PLAYING_H
#define TROCAR_PLAYING_H

#include <stdbool.h>

/* After this call, SIGINT and SIGTERM make playing_interrupted() return true instead of ending the process. */
void playing_heed_signals(void);
bool playing_interrupted(void);

/* Schedules the calling thread with SCHED_FIFO, which is inherited by threads that it creates. If this is not permitted, returns false and prints a
   note on stderr. */
bool playing_use_realtime(void);

double playing_now(void); /* s, monotonic */

#endif
