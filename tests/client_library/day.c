/* Sends as many wrenches as a server does in a day, as fast as they can be received, and checks that the client does not lose, repeat, reorder or alter any.
   liblcm sends them, from another process, through a real socket. Each wrench is computed from its tick on both sides. It is compared after the client has
   stored it and before the client asks for the next datagram (recvfrom is replaced). The device's loop reads the newest wrench once per millisecond. The
   client is included as source, so that its internal data can be read.
   usage: day [COUNT]     (in a private network namespace; a day at 1 kHz: 86400000, the default) */
#define _GNU_SOURCE
#include "trocar_client.c"

#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>

#include <lcm/lcm.h>

#include "trocar_needle_wrench_t.h"

enum { AHEAD = 100 }; /* how many wrenches the sender may be ahead, so that they fit into the socket's buffer */
static const char url[] = "udpm://239.255.76.67:7667?ttl=0";
static const double PERIOD = 1e-3, LONGEST_SILENCE = 60; /* s */

/* Shared by the two processes. */
static struct {
    int64_t received; /* wrenches received so far, and the tick of the next one */
    int64_t session;
} *both;

/* Returns the `i`-th number of this tick's wrench: random bits that form a finite number. */
static double number_of(int64_t tick, int i) {
    uint64_t bits = (uint64_t)tick * UINT64_C(0x9e3779b97f4a7c15) + (uint64_t)i * UINT64_C(0xbf58476d1ce4e5b9);
    double number;
    bits ^= bits >> 31, bits *= UINT64_C(0x94d049bb133111eb);
    bits = (bits ^ bits >> 29) & ~(UINT64_C(1) << 62); /* clears an exponent bit, so that the number is neither infinite nor NaN */
    memcpy(&number, &bits, sizeof number);
    return number;
}

static int32_t integer_of(int64_t tick, int i) { return (int32_t)((uint64_t)tick * UINT64_C(2654435761) >> i); }

static void send_all(int64_t count) {
    lcm_t *lcm = lcm_create(url);
    if (lcm == NULL) exit(1);
    for (int64_t tick = 0; tick < count; tick++) {
        while (tick - __atomic_load_n(&both->received, __ATOMIC_ACQUIRE) >= AHEAD) sched_yield();
        trocar_needle_wrench_t w = {.tick = tick, .session = both->session, .server = 5, .depth = number_of(tick, 6), .contacts = integer_of(tick, 0),
                                    .events = integer_of(tick, 1), .membrane = integer_of(tick, 2), .flags = integer_of(tick, 3)};
        for (int i = 0; i < 3; i++) w.force[i] = number_of(tick, i), w.torque[i] = number_of(tick, 3 + i);
        if (trocar_needle_wrench_t_publish(lcm, "TROCAR_WRENCH", &w) != 0) exit(1);
    }
    lcm_destroy(lcm);
}

/* ---- the client's thread ------------------------------------------------------------------------------------------------- */

static int64_t wrong; /* wrenches that differ from the expected one */
static double received_at;

static bool is_expected(const trocar_client_wrench *w, int64_t tick) {
    for (int i = 0; i < 3; i++)
        if (w->force[i] != number_of(tick, i) || w->torque[i] != number_of(tick, 3 + i)) return false;
    return w->tick == tick && w->depth == number_of(tick, 6) && w->contacts == integer_of(tick, 0) && w->events == integer_of(tick, 1) &&
           w->membrane == integer_of(tick, 2) && w->flags == integer_of(tick, 3);
}

ssize_t __real_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length);
ssize_t __wrap_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length);

/* Checks what the client has made of the last datagram, and receives the next one. */
ssize_t __wrap_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length) {
    static bool is_wrench;
    static unsigned slot; /* where the client has stored the wrench */
    const trocar_client *c = (const trocar_client *)((const char *)buffer - offsetof(trocar_client, datagram));
    if (is_wrench) {
        wrong += c->wrench_slots.back == slot || !is_expected(&c->wrenches[slot].wrench, both->received);
        received_at = now();
        __atomic_store_n(&both->received, both->received + 1, __ATOMIC_RELEASE);
    }
    slot = c->wrench_slots.back;
    ssize_t got = __real_recvfrom(s, buffer, size, flags, from, length);
    is_wrench = got > 8 + (ssize_t)sizeof WRENCHES && strcmp((const char *)buffer + 8, WRENCHES) == 0;
    return got;
}

/* ---- the device's loop --------------------------------------------------------------------------------------------------- */

int main(int count, char **arguments) {
    int64_t wrenches = count == 1 ? 86400000 : count == 2 ? strtoll(arguments[1], NULL, 10) : 0;
    if (wrenches < 1) {
        fprintf(stderr, "usage: day [COUNT]\n");
        return 2;
    }
    both = mmap(NULL, sizeof *both, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    trocar_client *c = both == MAP_FAILED ? NULL : trocar_client_open(&(trocar_client_options){.url = url}, NULL, 0);
    if (c == NULL) return 1;
    both->session = c->session;
    pid_t parent = getpid(), sender = fork();
    if (sender == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (getppid() == parent) send_all(wrenches);
        exit(0);
    }
    double begin = now();
    int64_t read = 0, newest = -1, mistaken = 0;
    received_at = begin;
    while (__atomic_load_n(&both->received, __ATOMIC_ACQUIRE) < wrenches && now() - received_at < LONGEST_SILENCE) {
        trocar_client_wrench w;
        nanosleep(&(struct timespec){.tv_nsec = (long)(1e9 * PERIOD)}, NULL);
        if (!trocar_client_newest(c, &w)) continue;
        mistaken += w.tick < newest || w.depth != number_of(w.tick, 6);
        newest = w.tick;
        read++;
    }
    double lasted = now() - begin;
    int64_t received = both->received;
    kill(sender, SIGKILL);
    waitpid(sender, NULL, 0);
    trocar_client_close(c);
    printf("%lld of %lld wrenches received in %.0f s (%.0f per second), %lld wrong; %lld read by the device's loop, %lld wrong\n", (long long)received,
           (long long)wrenches, lasted, (double)received / lasted, (long long)wrong, (long long)read, (long long)mistaken);
    return received != wrenches || wrong != 0 || mistaken != 0 || newest < 0;
}
