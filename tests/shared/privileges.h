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

/* Permanently removes CAP_SYS_NICE from the calling thread and from threads it starts later. Capabilities belong to a thread, and the raw system call,
   unlike libcap, leaves other threads alone. */
static inline bool drop_sys_nice(void) {
    struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
    struct __user_cap_data_struct sets[_LINUX_CAPABILITY_U32S_3];
    if (syscall(SYS_capget, &header, sets) != 0) return false;
    const __u32 bit = 1u << CAP_SYS_NICE; /* CAP_SYS_NICE is less than 32, so the bit is in the first word */
    sets[0].effective &= ~bit;
    sets[0].permitted &= ~bit;
    sets[0].inheritable &= ~bit;
    return syscall(SYS_capset, &header, sets) == 0;
}

static inline bool use_fifo(int flag) {
    return sched_setscheduler(0, SCHED_FIFO | flag, &(struct sched_param){.sched_priority = PRIORITY_HAPTIC}) == 0;
}

/* Gives the calling thread the privileges of the packaged service: SCHED_FIFO 80 is permitted, but SCHED_RESET_ON_FORK is set and cannot be cleared. The
   service has a raised RLIMIT_RTPRIO. Not every machine lets root raise the limit, so here the thread is given the priority beforehand. Returns false if
   this machine does not permit SCHED_FIFO at all. */
static inline bool become_a_service(void) {
    return use_fifo(SCHED_RESET_ON_FORK) && drop_sys_nice();
}

/* Takes away the calling thread's permission for real-time priorities and sets the process's limit to zero. Returns false if SCHED_FIFO is still possible. */
static inline bool lose_realtime(void) {
    return drop_sys_nice() && setrlimit(RLIMIT_RTPRIO, &(struct rlimit){0}) == 0 && !use_fifo(0);
}

#endif
