/* Runs a test that depends on time, and tells a slow program from a stalled machine.
   usage: witness [--once | --reports] [--tolerates MS] COMMAND [ARGUMENT...]

   A hypervisor that takes the processors away for milliseconds makes any real-time program late. One thread per processor, with a higher priority than
   everything under test, wakes up every millisecond and records its own lateness. A failure on a machine without stalls counts. A test that fails while the
   machine was stalled is run once more; if it fails again while the machine was stalled, the status is 77 (skipped), and the message says how long the
   machine was stalled.

   A sanitizer's report in the command's output is a failure on any machine, and so is a program killed by a signal. (The reports are not written to a file,
   because with several sanitizers UBSan, as of GCC 12, writes to standard error regardless of the option log_path.)
   --once: no second run; for instrumented programs, which are slow. --reports: a test that ran to its end without a report has passed, whatever its status.
   This is for ThreadSanitizer, under which a tick sometimes takes milliseconds (its shadow memory is mapped on first touch); all other failures are detected
   by the other presets. --tolerates: a single stall that is longer than this counts as well, however rare stalls are. This is for tests that send a pose
   every millisecond and check every flag: after device.hold_time without a pose, the server says that poses are stale. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/pidfd.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum {
    SKIPPED = 77,
    CANNOT_RUN = 126,                /* a status from here on means that there is no such program, or that a signal killed it */
    MAX_PROCESSORS = 64,
    PRIORITY = 98,                   /* above the server (80) and below the kernel's own threads (99) */
    PERIOD_NS = 1000000,
    LATE_NS = 500000,                /* ns, lateness above which a wake-up counts as late; on an idle machine, such a thread wakes up within about 50 us */
};

static const double QUIET = 2e-3;    /* fraction of late wake-ups that a test must tolerate */

typedef struct {
    int processor;
    bool real_time;
    long wakes, late;                /* wake-ups, and late ones among them; whole periods without a wake-up also count as late */
    long long longest_ns;
} observer;

static atomic_bool running;

static long long now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void *observe(void *context) {
    observer *o = context;
    cpu_set_t here;
    CPU_ZERO(&here);
    CPU_SET(o->processor, &here);
    o->real_time = pthread_setaffinity_np(pthread_self(), sizeof here, &here) == 0 &&
                   sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = PRIORITY}) == 0;
    for (long long due = now_ns(); o->real_time && atomic_load(&running);) {
        due += PERIOD_NS;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &(struct timespec){due / 1000000000, due % 1000000000}, NULL);
        long long late = now_ns() - due, missed = late / PERIOD_NS;
        o->wakes += 1 + missed;
        o->late += missed + (late % PERIOD_NS > LATE_NS);
        if (late > o->longest_ns) o->longest_ns = late;
        due += missed * PERIOD_NS;
    }
    return NULL;
}

/* Passes on the command's output until the command ends. Returns whether a sanitizer reported an error. A process left in the background may keep the pipe
   open and write to it forever, so after the command has ended, no more than a pipe's capacity is read. */
static bool pass_on(int pipe_end, int process) {
    enum { PIPE_HOLDS = 65536, CARRIED = 32 }; /* CARRIED: bytes kept from one piece of output to the next, longer than a report's marker */
    static const char *const reports[] = {"Sanitizer: ", "runtime error: "};
    static char text[CARRIED + 4096];
    struct pollfd sources[] = {{.fd = pipe_end, .events = POLLIN}, {.fd = process, .events = POLLIN}};
    bool reported = false;
    size_t carried = 0;
    for (long left = LONG_MAX; left > 0;) {
        int found = poll(sources, 2, -1);
        if (found < 0 && errno == EINTR) continue;
        if (found < 0) break;
        if (sources[1].revents != 0 && left > PIPE_HOLDS) left = PIPE_HOLDS;
        ssize_t count = sources[0].revents != 0 ? read(pipe_end, text + carried, sizeof text - carried) : 0;
        if (count <= 0) break;
        left -= count;
        fwrite(text + carried, 1, (size_t)count, stdout);
        fflush(stdout);
        size_t length = carried + (size_t)count;
        for (size_t i = 0; i < sizeof reports / sizeof *reports; i++) reported |= memmem(text, length, reports[i], strlen(reports[i])) != NULL;
        carried = length < CARRIED ? length : CARRIED;
        memmove(text, text + length - carried, carried);
    }
    return reported;
}

static int run(char *const command[], bool *reported) {
    int status = 0, ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return CANNOT_RUN;
    pid_t child = fork();
    if (child == 0) {
        dup2(ends[1], STDOUT_FILENO);
        dup2(ends[1], STDERR_FILENO);
        execvp(command[0], command);
        fprintf(stderr, "witness: cannot run %s: %s\n", command[0], strerror(errno));
        _exit(CANNOT_RUN);
    }
    close(ends[1]);
    int process = child > 0 ? pidfd_open(child, 0) : -1;
    if (process >= 0) *reported = pass_on(ends[0], process);
    else perror("witness: no process to watch");
    close(ends[0]);
    close(process);
    if (process < 0) return CANNOT_RUN;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) continue;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

/* Returns the command's exit status. *quiet is set to true if the machine did not stall in the meantime or could not be monitored. */
static int run_watched(char *const command[], long long tolerated_ns, bool *quiet, bool *reported) {
    pthread_t threads[MAX_PROCESSORS];
    observer observers[MAX_PROCESSORS] = {0};
    cpu_set_t usable;
    int count = 0;
    sched_getaffinity(0, sizeof usable, &usable);
    atomic_store(&running, true);
    for (int cpu = 0; cpu < CPU_SETSIZE && count < MAX_PROCESSORS; cpu++) {
        if (!CPU_ISSET(cpu, &usable)) continue;
        observers[count].processor = cpu;
        if (pthread_create(&threads[count], NULL, observe, &observers[count]) == 0) count++;
    }
    int status = run(command, reported);
    atomic_store(&running, false);
    *quiet = getenv("TROCAR_WITNESS_STALLED") == NULL; /* set by test_witness.sh */
    for (int i = 0; i < count; i++) {
        const observer *o = &observers[i];
        pthread_join(threads[i], NULL);
        if (!o->real_time || ((double)o->late <= QUIET * (double)o->wakes && o->longest_ns <= tolerated_ns)) continue;
        *quiet = false;
        if (status != 0)
            printf("witness: processor %d was away for %ld of %ld ms, once for %.1f ms\n", o->processor, o->late, o->wakes,
                   1e-6 * (double)o->longest_ns);
    }
    return status;
}

int main(int count, char **arguments) {
    bool reports = count > 1 && strcmp(arguments[1], "--reports") == 0;
    bool once = reports || (count > 1 && strcmp(arguments[1], "--once") == 0);
    char **command = arguments + 1 + once;
    long long tolerated_ns = LLONG_MAX;
    if (*command != NULL && command[1] != NULL && strcmp(*command, "--tolerates") == 0) {
        tolerated_ns = 1000000 * atoll(command[1]);
        command += 2;
    }
    if (*command == NULL) return 2;
    for (int attempt = 1; attempt <= (once ? 1 : 2); attempt++) {
        bool quiet, reported = false;
        int status = run_watched(command, tolerated_ns, &quiet, &reported);
        if (reported) return status == 0 || status == SKIPPED ? 1 : status;
        if (status == 0 || status == SKIPPED || status >= CANNOT_RUN || (quiet && !reports)) return status;
        if (reports) {
            printf("witness: status %d without a report: passed\n", status);
            return 0;
        }
        printf("witness: attempt %d failed with status %d while the machine stood still\n", attempt, status);
        fflush(stdout);
    }
    printf("witness: not judged: this machine does not keep time\n");
    return SKIPPED;
}
