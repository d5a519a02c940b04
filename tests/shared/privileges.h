/* Changes a thread's real-time privileges. */
#ifndef TROCAR_TEST_PRIVILEGES_H
#define TROCAR_TEST_PRIVILEGES_H

#include <linux/capability.h>
#include <sched.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/realtime.h"

/* Permanently drops CAP_SYS_NICE from the calling thread and the threads that it starts. Capabilities are per thread; unlike
   libcap, the bare system call does not change the other threads. */
static inline bool drop_sys_nice(void) {
    struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
    struct __user_cap_data_struct sets[_LINUX_CAPABILITY_U32S_3];
    if (syscall(SYS_capget, &header, sets) != 0) return false;
    const __u32 bit = 1u << CAP_SYS_NICE; /* below 32, so in the first word */
    sets[0].effective &= ~bit;
    sets[0].permitted &= ~bit;
    sets[0].inheritable &= ~bit;
    return syscall(SYS_capset, &header, sets) == 0;
}

static inline bool use_fifo(int flag) {
    return sched_setscheduler(0, SCHED_FIFO | flag, &(struct sched_param){.sched_priority = PRIORITY_HAPTIC}) == 0;
}

/* Gives the calling thread the privileges of the packaged service: SCHED_FIFO 80 is permitted, but SCHED_RESET_ON_FORK is set and
   can't be cleared. The service has a raised limit of real-time priority. Here the thread gets the priority beforehand, because not
   every machine lets root raise the limit. Returns false if this machine does not permit SCHED_FIFO at all. */
static inline bool become_a_service(void) {
    return use_fifo(SCHED_RESET_ON_FORK) && drop_sys_nice();
}

/* Drops the calling thread's permission for real-time priority and sets the process's limit to zero. Returns false if SCHED_FIFO
   is still possible. */
static inline bool lose_realtime(void) {
    return drop_sys_nice() && setrlimit(RLIMIT_RTPRIO, &(struct rlimit){0}) == 0 && !use_fifo(0);
}

#endif
