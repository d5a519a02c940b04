#define _GNU_SOURCE
#include "device/playing.h"

#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "common/realtime.h"
#include "common/timing.h"

static volatile sig_atomic_t interrupted;

static void interrupt(int signal) {
    (void)signal;
    interrupted = 1;
}

void playing_heed_signals(void) {
    struct sigaction action = {.sa_handler = interrupt};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
}

bool playing_interrupted(void) { return interrupted; }

bool playing_use_realtime(void) {
    int error = realtime_use_fifo(PRIORITY_DEVICE);
    if (error == 0) return true;
    fprintf(stderr, "%s: SCHED_FIFO refused (%s): raise the limit rtprio; running without real time\n", program_invocation_short_name, strerror(error));
    return false;
}

double playing_now(void) { return 1e-9 * (double)monotonic_ns(); }
