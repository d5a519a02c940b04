#define _GNU_SOURCE
#include "common/realtime.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/flush_denormals.h"

enum { LARGEST_FAULTED_IN = 32 << 20 }; /* bytes; larger mappings are not touched in advance */

/* Touches all pages of code, data, heap and stacks. Skips the large buffers that libraries reserve for other threads, because clearing hundreds of megabytes
   would take half of the start-up time. */
static void fault_in(void) {
    FILE *maps = fopen("/proc/self/maps", "r");
    char line[4500], access[5];
    uintptr_t from, to;
    while (maps != NULL && fgets(line, sizeof line, maps) != NULL) {
        if (sscanf(line, "%" SCNxPTR "-%" SCNxPTR " %4s", &from, &to, access) != 3) continue;
        if (access[0] != 'r' || to - from > LARGEST_FAULTED_IN) continue;
        madvise((void *)from, to - from, access[1] == 'w' ? MADV_POPULATE_WRITE : MADV_POPULATE_READ);
    }
    if (maps != NULL) fclose(maps);
}

/* Locks each page when it is first touched. If whole mappings were locked at once, a thread would stall for 40 ms each time a library maps 128 MiB at run time.
   */
static trocar_status lock_what_is_touched(trocar_error *why) {
    if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) return TROCAR_OK;
    return fail(why, TROCAR_NO_REALTIME,
                "cannot lock memory: %s. Raise the limit (`ulimit -l unlimited`, or `memlock` in "
                "/etc/security/limits.conf), grant CAP_IPC_LOCK, or run with --allow-non-rt", strerror(errno));
}

trocar_status realtime_lock_memory(trocar_error *why) {
    trocar_status status = lock_what_is_touched(why);
    if (status == TROCAR_OK) fault_in();
    return status;
}

int realtime_use_fifo(int priority) {
    struct sched_param wanted = {.sched_priority = priority};
    int keep = sched_getscheduler(0) & SCHED_RESET_ON_FORK;
    return sched_setscheduler(0, SCHED_FIFO | keep, &wanted) == 0 ? 0 : errno;
}

trocar_status realtime_set_priority(int priority, trocar_error *why) {
    int error = realtime_use_fifo(priority);
    if (error == 0) return TROCAR_OK;
    return fail(why, error == EPERM ? TROCAR_NO_REALTIME : TROCAR_SYSTEM,
                "cannot use SCHED_FIFO priority %d: %s. Raise the limit (`ulimit -r %d`, or `rtprio` in "
                "/etc/security/limits.conf), grant CAP_SYS_NICE, or run with --allow-non-rt",
                priority, strerror(error), priority);
}

trocar_status realtime_check_permission(int priority, trocar_error *why) {
    struct sched_param before;
    sched_getparam(0, &before);
    int policy = sched_getscheduler(0); /* `policy` includes the flag SCHED_RESET_ON_FORK */
    trocar_status status = realtime_set_priority(priority, why);
    if (status != TROCAR_OK) return status;
    sched_setscheduler(0, policy, &before);
    status = lock_what_is_touched(why);
    if (status == TROCAR_OK) munlockall();
    return status;
}

void realtime_hurry(void) {
    struct sched_param lowest = {.sched_priority = 1};
    sched_setscheduler(0, SCHED_FIFO | SCHED_RESET_ON_FORK, &lowest);
}

void realtime_take_time(void) {
    struct sched_param none = {.sched_priority = 0};
    sched_setscheduler(0, SCHED_OTHER | SCHED_RESET_ON_FORK, &none);
}

__attribute__((noinline)) void realtime_touch_stack(void) {
    unsigned char stack[REALTIME_STACK_TOUCHED];
    memset(stack, 0, sizeof stack);
    __asm__ volatile("" : : "r"(stack) : "memory"); /* keeps the compiler from dropping the writes */
}

void realtime_flush_denormals(void) { flush_denormals(); }

int realtime_stay_awake(trocar_error *why) {
    static const char path[] = "/dev/cpu_dma_latency";
    int descriptor = open(path, O_WRONLY | O_CLOEXEC);
    int32_t microseconds = 0;
    if (descriptor >= 0 && write(descriptor, &microseconds, sizeof microseconds) == (ssize_t)sizeof microseconds) return descriptor;
    fail(why, TROCAR_SYSTEM, "%s: %s; let the server's user write to it (group trocar)", path, strerror(errno));
    if (descriptor >= 0) close(descriptor);
    return -1;
}
