/* Measures round trips of the free client (over multicast and over unicast) and of liblcm, alternating between them in one run. A round trip is the time
   from sending a pose until the wrench that another process sends in reply has arrived. Over unicast, both pass through the server's relay thread. The free
   client has no function that waits, so its device loop polls for the newest wrench until it arrives. With liblcm, the loop either polls as well, or waits in
   lcm_handle, as programs with liblcm usually do. Either way, a thread of the library receives the message and passes it on.
   usage: latency ROUNDS     (in a private network namespace) */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <lcm/lcm.h>

#include "common/eventfd_signal.h"
#include "relay.h"
#include "trocar_client.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

enum { BLOCK = 250, WARM_UP = 5, DEVICE = 70, NETWORK = 75, ECHO = 80 }; /* rounds; priorities */
static const double LONGEST = 0.02; /* s */
static const double position[3] = {0, 0, 0}, orientation[4] = {1, 0, 0, 0};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Returns false if the priority is not permitted. */
static bool use_priority(int priority) { return sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = priority}) == 0; }

/* ---- the other process, without any library's delays -------------------------------------------------------------------- */

static exchange shared;

/* Starts a relay for udp://127.0.0.1:7668. */
static void start_relay(bool real_time) {
    static relay r;
    const struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(7668), .sin_addr = {htonl(INADDR_LOOPBACK)}};
    wire_key secret = wire_secret_key("", 0);
    pthread_t thread;
    trocar_error why;
    if (exchange_create(&shared, NULL, &why) != TROCAR_OK || relay_create(&r, &address, &secret, NULL, real_time, &shared, &why) != TROCAR_OK ||
        pthread_create(&thread, NULL, relay_run, &r) != 0) {
        fprintf(stderr, "latency: %s\n", why.text);
        exit(1);
    }
}

/* Passes a message to the relay, as the server's IO thread does. */
static void pass_on(int64_t session, const char *channel, const void *message, size_t size) {
    outgoing_message m = {.session = session, .channel = channel, .size = size};
    memcpy(m.bytes, message, size);
    if (spsc_ring_push(&shared.outgoing, &m)) eventfd_signal(shared.relay_wake);
}

static void answer_poses(bool real_time) {
    static const char pose_channel[] = "TROCAR_POSE", wrench_channel[] = "TROCAR_WRENCH";
    static unsigned char packet[65536];
    struct sockaddr_in group = {.sin_family = AF_INET, .sin_port = htons(7667), .sin_addr = {inet_addr("239.255.76.67")}};
    int receiver = socket(AF_INET, SOCK_DGRAM, 0), sender = socket(AF_INET, SOCK_DGRAM, 0), yes = 1;
    setsockopt(receiver, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    if (bind(receiver, (struct sockaddr *)&group, sizeof group) != 0 ||
        setsockopt(receiver, IPPROTO_IP, IP_ADD_MEMBERSHIP, &(struct ip_mreq){.imr_multiaddr = group.sin_addr}, sizeof(struct ip_mreq)) != 0) {
        perror("latency");
        exit(1);
    }
    start_relay(real_time);
    use_priority(ECHO);
    for (ssize_t size; (size = recv(receiver, packet, sizeof packet, 0)) >= 0;) {
        trocar_needle_pose_t pose;
        if (size < (ssize_t)(8 + sizeof pose_channel) || strcmp((char *)packet + 8, pose_channel) != 0) continue;
        if (trocar_needle_pose_t_decode(packet, 8 + (int)sizeof pose_channel, (int)sizeof packet, &pose) < 0) continue;
        trocar_needle_wrench_t wrench = {.session = pose.session, .tick = pose.seq + 1, .server = 5, .pose_seq = pose.seq};
        memcpy(packet + 8, wrench_channel, sizeof wrench_channel);
        int length = trocar_needle_wrench_t_encode(packet, 8 + (int)sizeof wrench_channel, (int)sizeof packet, &wrench);
        pass_on(pose.session, wrench_channel, packet + 8 + sizeof wrench_channel, (size_t)length);
        sendto(sender, packet, 8 + sizeof wrench_channel + (size_t)length, 0, (struct sockaddr *)&group, sizeof group);
    }
}

/* ---- the clients --------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_client *client;
    int64_t tick;
} free_one;

static bool free_round(void *user) {
    free_one *f = user;
    trocar_client_wrench wrench;
    int64_t before = f->tick;
    trocar_client_publish(f->client, position, orientation);
    for (double end = now() + LONGEST; f->tick == before && now() < end;)
        if (trocar_client_newest(f->client, &wrench)) f->tick = wrench.tick;
    return f->tick != before;
}

typedef struct {
    lcm_t *lcm;
    int64_t seq, tick;
} lcm_one;

static void on_wrench(const lcm_recv_buf_t *buffer, const char *channel, const trocar_needle_wrench_t *m, void *user) {
    (void)buffer, (void)channel;
    lcm_one *l = user;
    if (m->session == 3) l->tick = m->tick;
}

static bool lcm_round(lcm_one *l, int longest) {
    trocar_needle_pose_t pose = {.session = 3, .seq = l->seq++};
    memcpy(pose.orientation, orientation, sizeof pose.orientation);
    trocar_needle_pose_t_publish(l->lcm, "TROCAR_POSE", &pose);
    for (double end = now() + LONGEST; l->tick != l->seq && now() < end;) lcm_handle_timeout(l->lcm, longest);
    return l->tick == l->seq;
}

static bool lcm_polling_round(void *user) { return lcm_round(user, 0); }
static bool lcm_waiting_round(void *user) { return lcm_round(user, 20); }

static int ascending(const void *a, const void *b) { return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b); }

typedef struct {
    const char *name;
    bool (*round)(void *);
    void *user;
    double *times;           /* s */
    int count, lost;
} series;

static void measure(series *s, int rounds) {
    for (int i = -WARM_UP; i < rounds; i++) {
        nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
        double begin = now();
        bool answered = s->round(s->user);
        if (i < 0) continue;
        if (answered) s->times[s->count++] = now() - begin;
        else s->lost++;
    }
}

static void print(series *s) {
    qsort(s->times, (size_t)s->count, sizeof *s->times, ascending);
    printf("%-15s p50 %6.1f us  p99 %6.1f us  max %7.1f us  %d of %d lost\n", s->name, 1e6 * s->times[s->count / 2], 1e6 * s->times[s->count * 99 / 100],
           1e6 * s->times[s->count - 1], s->lost, s->count + s->lost);
}

int main(int count, char **arguments) {
    int rounds = count == 2 ? atoi(arguments[1]) : 0;
    if (rounds < 1) {
        fprintf(stderr, "usage: latency ROUNDS\n");
        return 2;
    }
    pid_t parent = getpid();
    bool permitted = use_priority(NETWORK);
    sched_setscheduler(0, SCHED_OTHER, &(struct sched_param){0});
    if (fork() == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (getppid() == parent) answer_poses(permitted);
        return 1;
    }
    bool real_time = use_priority(NETWORK); /* liblcm's thread inherits the priority of the thread that subscribes */
    lcm_one l = {.lcm = lcm_create(NULL)};
    free_one f = {.client = trocar_client_open(&(trocar_client_options){.priority = real_time ? NETWORK : 0}, NULL, 0)};
    free_one u = {.client = trocar_client_open(&(trocar_client_options){.url = "udp://127.0.0.1:7668", .priority = real_time ? NETWORK : 0}, NULL, 0)};
    if (l.lcm == NULL || f.client == NULL || u.client == NULL || trocar_needle_wrench_t_subscribe(l.lcm, "TROCAR_WRENCH", on_wrench, &l) == NULL) return 1;
    if (real_time) use_priority(DEVICE);
    enum { ALL = 4 };
    series all[ALL] = {{"free", free_round, &f, malloc((size_t)rounds * sizeof(double)), 0, 0},
                       {"unicast", free_round, &u, malloc((size_t)rounds * sizeof(double)), 0, 0},
                       {"liblcm, polling", lcm_polling_round, &l, malloc((size_t)rounds * sizeof(double)), 0, 0},
                       {"liblcm, waiting", lcm_waiting_round, &l, malloc((size_t)rounds * sizeof(double)), 0, 0}};
    for (int done = 0; done < rounds; done += BLOCK)
        for (int i = 0; i < ALL; i++) {
            while (lcm_handle_timeout(l.lcm, 0) > 0) continue; /* discards messages meant for another client */
            measure(&all[i], rounds - done < BLOCK ? rounds - done : BLOCK);
        }
    printf("%s\n", real_time ? "SCHED_FIFO" : "without real time");
    for (int i = 0; i < ALL; i++) {
        if (all[i].count == 0) return 1;
        print(&all[i]);
    }
    trocar_client_close(f.client);
    trocar_client_close(u.client);
    lcm_destroy(l.lcm);
    return all[0].lost > rounds / 100 || all[1].lost > rounds / 100;
}
