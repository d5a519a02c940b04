/* Linux settings for real-time threads: locked memory, FIFO priority, flush-to-zero. */
#ifndef TROCAR_REALTIME_H
#define TROCAR_REALTIME_H

#include <stdbool.h>

#include "base/error.h"

enum { PRIORITY_HAPTIC = 80, PRIORITY_IO = 75, PRIORITY_DEVICE = 70, PRIORITY_RELAY = 10 };

/* Brings the process's memory into RAM and locks it, except for large untouched buffers. Pages touched later are locked as well. NO_REALTIME if this is not
   permitted, with a message that names the limit to raise. */
trocar_status realtime_lock_memory(trocar_error *why);

/* Schedules the calling thread with SCHED_FIFO. Leaves SCHED_RESET_ON_FORK as it is, because only a process with CAP_SYS_NICE can clear it. Returns 0 or an
   errno value. */
int realtime_use_fifo(int priority);

/* Like realtime_use_fifo, but sets an error message. NO_REALTIME if not permitted (the message names the limit to raise); SYSTEM if there is no such priority.
   */
trocar_status realtime_set_priority(int priority, trocar_error *why);

/* Checks whether this process may lock memory and use SCHED_FIFO up to `priority`. Changes nothing. Errors as above. */
trocar_status realtime_check_permission(int priority, trocar_error *why);

/* Raises the calling thread's priority above that of all normal threads, if permitted, so that a server that has crashed restarts quickly even on a busy
   machine. Threads that it creates do not inherit this: they start at normal priority with a nice value of at least 0. It cannot be undone, so call this only
   on a thread that will end. */
void realtime_hurry(void);

/* Returns the calling thread to normal priority. Call this before a long computation on all processors: its threads do not inherit a raised priority, and would
   be kept from running by a high-priority thread that waits for them. */
void realtime_take_time(void);

/* Touches the calling thread's stack so that it causes no page faults later. The thread needs a stack of REALTIME_STACK bytes. */
enum { REALTIME_STACK = 2 << 20, REALTIME_STACK_TOUCHED = 1 << 20 };
void realtime_touch_stack(void);

/* Treats denormal operands and results as zero, because computing with them is a hundred times slower. Every computing thread must call this, in real-time and
   in lockstep mode; otherwise results would differ between the two. */
void realtime_flush_denormals(void);

/* Keeps the processors out of deep sleep states, which take long to leave. Returns a descriptor to keep open, or -1 with the reason in `why`. */
int realtime_stay_awake(trocar_error *why);

#endif
