/* A single thread waits for two events: the timer, when the next pose is due, and LCM's socket, when a wrench arrives. Deadlines are absolute, so the rate does
   not drift; missed periods are skipped and counted. */
#include "device/player.h"

#include <errno.h>
#include <inttypes.h>
#include <poll.h>
#include <string.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

#include "common/network.h"
#include "common/session.h"
#include "common/timing.h"
#include "device/playing.h"
#include "lcm_filter.h"
#include "shared/poselog.h"
#include "shared/server_choice.h"
#include "trocar_command_t.h"

static const double last_answers = 0.008; /* s to keep listening after the last pose; shorter than the server's hold time */

typedef struct {
    const play_settings *settings;
    recording *record;
    server_choice servers;
    lcm_t *lcm;
    int timer;
    double period;           /* s */
    hand hand;
    vec3 force;              /* N, newest force on the hand */
    int64_t wrench_tick;     /* server tick of `force` */
    trocar_status status;    /* of the first failure in a callback */
    trocar_error *why;
} player;

/* True if wrenches from this server are used. Any other server is reported once, and its wrenches are counted. */
static bool follow(player *p, int64_t server) {
    if (server_choice_follows(&p->servers, server, playing_now())) return true;
    if (p->record->foreign_wrenches++ == 0)
        fprintf(stderr, "trocar-device: two servers answer on this LCM URL: following %016" PRIx64 ", not %016" PRIx64 "; stop one of them\n",
                (uint64_t)p->servers.followed, (uint64_t)server);
    return false;
}

static void on_wrench(const lcm_recv_buf_t *buffer, const char *channel, void *user) {
    (void)channel;
    player *p = user;
    trocar_needle_wrench_t wrench;
    if (trocar_needle_wrench_t_decode(buffer->data, 0, (int)buffer->data_size, &wrench) != (int)buffer->data_size) return;
    if (wrench.session != p->record->session || wrench.needle != p->settings->needle || !follow(p, wrench.server)) return;
    p->force = v3(wrench.force[0], wrench.force[1], wrench.force[2]);
    p->wrench_tick = wrench.tick;
    trocar_status status = recording_add_wrench(p->record, playing_now(), &wrench, p->why);
    if (p->status == TROCAR_OK) p->status = status;
}

/* Returns the pose of the base t seconds after the script starts: the script's or, with a simulated hand, that of the hand as it follows the script. */
static pose next_pose(player *p, double t) {
    pose wanted = motion_pose(p->settings->script, p->settings->start, t * p->settings->speed);
    if (!p->settings->closed_loop) return wanted;
    hand_step(&p->hand, wanted.position, p->force, p->period);
    return (pose){p->hand.position, wanted.orientation};
}

static trocar_status send_pose(player *p, double t) {
    recording *r = p->record;
    pose base = next_pose(p, t);
    trocar_needle_pose_t message = message_of_pose(base, wall_us(), r->session, r->sent_count);
    message.wrench_tick = p->settings->closed_loop ? p->wrench_tick : -1 - p->wrench_tick;
    message.needle = p->settings->needle;
    trocar_status status = recording_add_pose(r, playing_now(), base, p->why);
    if (status != TROCAR_OK) return status;
    if (trocar_needle_pose_t_publish(p->lcm, POSE_CHANNEL, &message) == 0) return TROCAR_OK;
    return fail(p->why, TROCAR_SYSTEM, "LCM cannot publish on %s: is there a multicast route (docs/troubleshooting.md)?", POSE_CHANNEL);
}

/* Waits for a wrench or the timer. Returns how many periods have elapsed, 0 after a wrench, or -1 if interrupted. */
static int wait_event(player *p) {
    struct pollfd events[2] = {{.fd = p->timer, .events = POLLIN}, {.fd = lcm_get_fileno(p->lcm), .events = POLLIN}};
    if (poll(events, 2, -1) < 0 || playing_interrupted()) return -1;
    if (events[1].revents) lcm_handle(p->lcm);
    uint64_t expired = 0;
    if (events[0].revents && read(p->timer, &expired, sizeof expired) < 0) return 0;
    return (int)expired;
}

/* Keeps sending the start pose until the server first answers. */
static trocar_status await_server(player *p) {
    double deadline = playing_now() + p->settings->patience;
    while (p->record->received_count == 0) {
        int periods = wait_event(p);
        if (periods < 0) return fail(p->why, TROCAR_SYSTEM, "interrupted before the server answered");
        trocar_status status = periods ? send_pose(p, 0) : p->status;
        if (status != TROCAR_OK) return status;
        if (playing_now() > deadline)
            return fail(p->why, TROCAR_SYSTEM,
                        "no answer within %g s for needle %d: check that trocar-server runs with the same LCM URL, that its scene has this "
                        "needle and that no other device owns it; trocar-top shows the server's last refusal",
                        p->settings->patience, p->settings->needle);
    }
    return TROCAR_OK;
}

/* Waits at the start for `settle` seconds, plays the script, then listens a little longer. */
static trocar_status play_script(player *p) {
    double start = playing_now() + p->settings->settle, t = 0;
    p->record->start = start;
    while (t < p->settings->duration + last_answers && p->status == TROCAR_OK) {
        int periods = wait_event(p);
        if (periods < 0) break;
        t = playing_now() - start;
        if (periods > 1 && t > 0) p->record->skipped_periods += periods - 1;
        if (periods == 0 || t >= p->settings->duration) continue;
        trocar_status status = send_pose(p, t);
        if (status != TROCAR_OK) return status;
    }
    return p->status;
}

static void release_needle(player *p) {
    trocar_command_t release = {.utime = wall_us(), .session = p->record->session,
                                .command = TROCAR_COMMAND_T_RELEASE, .needle = p->settings->needle};
    trocar_command_t_publish(p->lcm, "TROCAR_COMMAND", &release);
}

static trocar_status open_links(player *p) {
    trocar_status status = network_open(p->settings->lcm_url, &p->lcm, p->why);
    if (status != TROCAR_OK) return status;
    static const char *const channels[] = {WRENCH_CHANNEL, NULL};
    static const packet_wishes wishes = {.channels = channels, .whole_only = true};
    lcm_filter_restrict(&wishes);
    lcm_subscribe(p->lcm, WRENCH_CHANNEL, on_wrench, p);
    long period = lround(1e9 * p->period);
    struct itimerspec every = {.it_interval = {period / 1000000000, period % 1000000000}, .it_value = {0, 1}};
    p->timer = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    if (p->timer < 0 || timerfd_settime(p->timer, 0, &every, NULL) != 0)
        return fail(p->why, TROCAR_SYSTEM, "timer refused: %s", strerror(errno));
    return TROCAR_OK;
}

static void close_links(player *p) {
    if (p->timer >= 0) close(p->timer);
    if (p->lcm) lcm_destroy(p->lcm);
}

trocar_status play(const play_settings *settings, recording *r, trocar_error *why) {
    *r = (recording){.session = session_new()};
    player p = {.settings = settings, .record = r, .servers.patience = 0.1, .timer = -1, .period = 1.0 / settings->rate, .hand = settings->hand,
                .why = why};
    p.hand.position = settings->start.position;
    p.hand.velocity = v3(0, 0, 0);

    playing_heed_signals();
    if (settings->realtime) playing_use_realtime(); /* before LCM is created, so that its reader thread inherits the priority */

    trocar_status status = open_links(&p);
    if (status == TROCAR_OK) status = await_server(&p);
    if (status == TROCAR_OK) status = play_script(&p);
    if (p.lcm) release_needle(&p);
    close_links(&p);
    return status;
}
