/* What Linux permits a thread with regard to real time. */
#ifndef TROCAR_TEST_PRIVILEGES_H
#define TROCAR_TEST_PRIVILEGES_H

#include <linux/capability.h>
#include <sched.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "realtime.h"

/* Takes CAP_SYS_NICE from the calling thread and from those that it starts, for good. Capabilities belong to threads, and
   the system call, unlike a library, leaves the other threads theirs. */
static inline bool drop_sys_nice(void) {
    struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
    struct __user_cap_data_struct sets[_LINUX_CAPABILITY_U32S_3];
    if (syscall(SYS_capget, &header, sets) != 0) return false;
    const __u32 bit = 1u << CAP_SYS_NICE; /* below 32: in the first element */
    sets[0].effective &= ~bit;
    sets[0].permitted &= ~bit;
    sets[0].inheritable &= ~bit;
    return syscall(SYS_capset, &header, sets) == 0;
}

static inline bool use_fifo(int flag) {
    return sched_setscheduler(0, SCHED_FIFO | flag, &(struct sched_param){.sched_priority = PRIORITY_HAPTIC}) == 0;
}

/* Puts the calling thread where the packaged service is: SCHED_FIFO 80 is permitted, but not to clear the flag
   SCHED_RESET_ON_FORK, which is set. There the limit of real-time priority permits it, here that the thread has it already:
   not every machine lets root raise the limit. False if this machine does not permit SCHED_FIFO at all. */
static inline bool become_a_service(void) {
    return use_fifo(SCHED_RESET_ON_FORK) && drop_sys_nice();
}

/* Takes the right to real-time priority from the calling thread and, as far as the limit goes, from the process. */
static inline bool lose_realtime(void) {
    return drop_sys_nice() && setrlimit(RLIMIT_RTPRIO, &(struct rlimit){0}) == 0 && !use_fifo(0);
}

#endif
