/* What the process asks of Linux so that the loop keeps its time: locked memory, FIFO priority, flush-to-zero. */
#ifndef TROCAR_REALTIME_H
#define TROCAR_REALTIME_H

#include <stdbool.h>

#include "base/report.h"

enum { PRIORITY_HAPTIC = 80, PRIORITY_IO = 75, PRIORITY_DEVICE = 70 };

/* Faults in and locks the memory that the process has now (but for large buffers that nobody has touched), and what it
   touches later. NO_REALTIME with the limit to raise. */
trocar_status realtime_lock_memory(report *why);

/* Puts the calling thread under SCHED_FIFO and keeps its SCHED_RESET_ON_FORK flag, which Linux lets nobody clear without
   CAP_SYS_NICE. Returns 0 or an errno value. */
int realtime_use_fifo(int priority);

/* The same for a thread that needs it. NO_REALTIME with the limit to raise; SYSTEM if the priority does not exist. */
trocar_status realtime_set_priority(int priority, report *why);

/* Checks that this process may lock memory and use SCHED_FIFO up to `priority`, and leaves both as they were. Errors as
   above. */
trocar_status realtime_check_permission(int priority, report *why);

/* Puts the calling thread ahead of all normal work if permitted: a server that comes back after a fault has no time to lose
   on a busy machine. Threads that it creates do not inherit this: they start at normal priority and with a nice value of 0
   at best. There is no way back, so call it on a thread that ends. */
void realtime_hurry(void);

/* Touches the calling thread's stack, so that it never faults there. The thread needs a stack of
   REALTIME_STACK bytes. */
enum { REALTIME_STACK = 2 << 20, REALTIME_STACK_TOUCHED = 1 << 20 };
void realtime_touch_stack(void);

/* Denormal numbers count as zero, in operands and results: they cost a hundred times a normal number. Every thread
   that computes calls this, live and in lockstep, or the two would differ. */
void realtime_flush_denormals(void);

/* Keeps the processors out of deep sleep, where waking takes long. Returns a descriptor to keep open, or -1 and why. */
int realtime_stay_awake(report *why);

#endif
