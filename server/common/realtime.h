/* Linux settings for real-time threads: locked memory, FIFO priority, flush-to-zero. */
#ifndef TROCAR_REALTIME_H
#define TROCAR_REALTIME_H

#include <stdbool.h>

#include "base/error.h"

enum { PRIORITY_HAPTIC = 80, PRIORITY_IO = 75, PRIORITY_DEVICE = 70, PRIORITY_RELAY = 10 };

/* Loads the process's current memory into RAM and locks it, except large untouched buffers; also locks every page that the process touches later.
   NO_REALTIME if that is not permitted; the message names the limit to raise. */
trocar_status realtime_lock_memory(trocar_error *why);

/* Schedules the calling thread with SCHED_FIFO and keeps its SCHED_RESET_ON_FORK flag, which only a process with CAP_SYS_NICE can clear. Returns 0 or
   an errno value. */
int realtime_use_fifo(int priority);

/* Like realtime_use_fifo, but with an error message: NO_REALTIME, which names the limit to raise; SYSTEM if the priority does not exist. */
trocar_status realtime_set_priority(int priority, trocar_error *why);

/* Checks that this process may lock memory and use SCHED_FIFO up to `priority`, but changes neither. Errors as above. */
trocar_status realtime_check_permission(int priority, trocar_error *why);

/* Raises the calling thread's priority above that of all normal threads, if permitted, so that a server restarts quickly after a crash on a busy
   machine. Threads that it creates do not inherit the raised priority: they start at normal priority with a nice value of at least 0. The change
   cannot be undone, so call this function only on a thread that will end. */
void realtime_hurry(void);

/* Returns the calling thread to normal priority before a long computation on all processors. The computation's threads do not inherit a raised priority,
   and a high-priority thread waiting for them would keep them from running. */
void realtime_take_time(void);

/* Touches the pages of the calling thread's stack in advance, so that they cause no page faults later. The thread needs a stack of REALTIME_STACK
   bytes. */
enum { REALTIME_STACK = 2 << 20, REALTIME_STACK_TOUCHED = 1 << 20 };
void realtime_touch_stack(void);

/* Treats denormal operands and results as zero, because computing with them is a hundred times slower than with normal numbers. Every computing
   thread must call this function, in real-time and lockstep modes alike; otherwise their results would differ. */
void realtime_flush_denormals(void);

/* Keeps the processors out of deep sleep states, which take a long time to leave. Returns a descriptor to keep open, or -1 with the reason in `why`. */
int realtime_stay_awake(trocar_error *why);

#endif
