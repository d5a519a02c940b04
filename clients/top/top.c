/* trocar-top: a live view of a running trocar-server in the terminal: timing, poses, faults and wrenches. */
#include <curses.h>
#include <lcm/lcm.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/error.h"
#include "common/message_fit.h"
#include "common/timing.h"
#include "lcm_filter.h"
#include "shared/options.h"
#include "top/dashboard.h"
#include "top/udp_json.h"

const char *argp_program_version = "trocar-top " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

typedef struct {
    const char *lcm_url;     /* NULL selects $LCM_DEFAULT_URL or, if that is not set, LCM's default */
    bool plain, once;
    double wait;             /* s to wait for a server's first message with --once */
    const char *udp;         /* HOST:PORT to send datagrams to; NULL for none */
    double udp_rate;         /* Hz; 0 sends every wrench; NaN if not given */
} options;

enum { OPTION_ONCE = 256, OPTION_WAIT, OPTION_UDP, OPTION_UDP_RATE };

static const double UDP_RATE = 100; /* Hz */

static const struct argp_option option_list[] = {
    {"lcm-url", 'l', "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {"plain", 'p', 0, 0, "Print lines of text every second; the default where the output is a file or the terminal has no cursor control", 0},
    {"once", OPTION_ONCE, 0, 0, "Print the values once and exit", 0},
    {"wait", OPTION_WAIT, "SECONDS", 0, "With --once, give up if no server has been heard for this long (default 5)", 0},
    {"udp-json", OPTION_UDP, "HOST:PORT", 0,
     "Also send wrenches, timing and status as JSON datagrams, for example to PlotJuggler's UDP server on localhost:9870. Without a terminal, and "
     "without --plain, only errors are printed", 0},
    {"udp-rate", OPTION_UDP_RATE, "HZ", 0, "Wrenches per second and needle for --udp-json, the newest ones; 0: every wrench (default 100)", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 'l': o->lcm_url = text; break;
    case 'p': o->plain = true; break;
    case OPTION_ONCE: o->once = true; break;
    case OPTION_WAIT: o->wait = parse_number(state, "wait", text, 0, 1e6); break;
    case OPTION_UDP: o->udp = text; break;
    case OPTION_UDP_RATE: o->udp_rate = parse_number(state, "udp-rate", text, 0, 10000); break;
    case ARGP_KEY_END:
        if (o->once && o->udp) argp_error(state, "--once goes without --udp-json");
        if (!isnan(o->udp_rate) && !o->udp) argp_error(state, "--udp-rate needs --udp-json");
        break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Shows what trocar-server reports about its timing, its poses and its wrenches, with histograms of lateness and compute time."
    "\vKeys: q quits, c clears the histograms. Exit status of --once: 1 if no server was heard.", NULL, NULL, NULL};

/* ---- messages ---------------------------------------------------------------------------------------------------- */

static double now(void) { return 1e-9 * (double)monotonic_ns(); } /* s */

typedef struct {
    dashboard shown;
    udp_json udp;
    bool sends;              /* `udp` is open */
} monitor;

static bool is_followed(monitor *m, int64_t server) { return server_choice_follows(&m->shown.servers, server, now()); }

static void on_timing(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    monitor *d = context;
    trocar_loop_timing_t m;
    if (trocar_loop_timing_t_decode(received->data, 0, (int)received->data_size, &m) != (int)received->data_size) {
        d->shown.foreign++;
        return;
    }
    dashboard_take_timing(&d->shown, &m, now());
    if (d->sends && is_followed(d, m.server)) udp_json_timing(&d->udp, &m);
}

static void on_status(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    monitor *d = context;
    trocar_status_t m;
    if (!status_fits(received->data, received->data_size)
        || trocar_status_t_decode(received->data, 0, (int)received->data_size, &m) != (int)received->data_size) {
        d->shown.foreign++;
        return;
    }
    dashboard_take_status(&d->shown, &m, now());
    if (d->sends && is_followed(d, m.server)) udp_json_status(&d->udp, &m);
    trocar_status_t_decode_cleanup(&m);
}

static void on_wrench(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    monitor *d = context;
    trocar_needle_wrench_t m;
    bool whole = trocar_needle_wrench_t_decode(received->data, 0, (int)received->data_size, &m) == (int)received->data_size;
    if (whole && is_followed(d, m.server)) udp_json_wrench(&d->udp, &m);
}

static void on_pose(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    monitor *d = context;
    trocar_needle_pose_t m;
    if (trocar_needle_pose_t_decode(received->data, 0, (int)received->data_size, &m) == (int)received->data_size) udp_json_pose(&d->udp, &m);
}

static lcm_t *listen_to_server(const options *o, monitor *d, trocar_error *why) {
    static const char *const channels[] = {"TROCAR_TIMING", "TROCAR_STATUS", "TROCAR_WRENCH", "TROCAR_POSE", NULL}, *const shown[] = {"TROCAR_TIMING", "TROCAR_STATUS", NULL};
    static packet_wishes wishes = {.whole_only = true};
    wishes.channels = d->sends ? channels : shown;
    lcm_filter_restrict(&wishes);
    lcm_t *lcm = lcm_filter_create(o->lcm_url);
    bool heard = lcm && lcm_subscribe(lcm, "TROCAR_TIMING", on_timing, d) && lcm_subscribe(lcm, "TROCAR_STATUS", on_status, d);
    if (heard && d->sends) heard = lcm_subscribe(lcm, "TROCAR_WRENCH", on_wrench, d) && lcm_subscribe(lcm, "TROCAR_POSE", on_pose, d);
    if (heard) return lcm;
    fail(why, TROCAR_BAD_INPUT, "LCM cannot use \"%s\": check --lcm-url and the multicast route", o->lcm_url ? o->lcm_url : "its default URL");
    if (lcm) lcm_destroy(lcm);
    return NULL;
}

static volatile sig_atomic_t interrupted;

static void interrupt(int signal) {
    (void)signal;
    interrupted = 1;
}

/* Receives messages until the given time. If `keys` is true, also returns when a key is pressed or the window is resized. */
static void receive_until(lcm_t *lcm, double end, bool keys) {
    struct pollfd events[2] = {{.fd = lcm_get_fileno(lcm), .events = POLLIN}, {.fd = STDIN_FILENO, .events = POLLIN}};
    for (double left; (left = end - now()) > 0 && !interrupted;) {
        if (poll(events, keys ? 2 : 1, 1 + (int)(1e3 * left)) < 0) return;
        if (events[0].revents) lcm_handle(lcm);
        if (keys && events[1].revents) return;
    }
}

/* ---- screens ----------------------------------------------------------------------------------------------------- */

/* Writes the dashboard and, with --udp-json, a line about the datagrams. Returns the number of lines. */
static int draw_lines(const monitor *m, int height, dashboard_line lines[DASHBOARD_LINES + 1]) {
    int count = dashboard_draw(&m->shown, now(), m->sends ? height - 1 : height, lines);
    if (!m->sends) return count;
    char text[400];
    udp_json_describe(&m->udp, text, sizeof text);
    snprintf(lines[count].text, sizeof lines[count].text, "udp json    %.140s", text);
    lines[count].alarm = m->udp.error != 0;
    return count + 1;
}

static void print_lines(const monitor *m) {
    static dashboard_line lines[DASHBOARD_LINES + 1];
    int count = draw_lines(m, 24, lines);
    for (int i = 0; i < count; i++) printf("%c %s\n", lines[i].alarm ? '!' : ' ', lines[i].text);
    printf("\n");
    fflush(stdout);
}

static int print_once(const options *o, lcm_t *lcm, monitor *m) {
    double end = now() + o->wait;
    while (!m->shown.heard && now() < end && !interrupted) receive_until(lcm, now() + 0.1, false);
    if (m->shown.heard) receive_until(lcm, now() + 0.3, false);  /* lets the status arrive */
    print_lines(m);
    return m->shown.heard ? EXIT_SUCCESS : EXIT_FAILURE;
}

/* Sends datagrams without a display. Reports on stderr when a server appears or falls silent, and when the datagrams start or stop getting through. */
static int send_only(lcm_t *lcm, const monitor *m) {
    static const double silence = 1.0; /* s */
    bool heard = true;
    int error = 0;
    for (double since = now(); !interrupted;) {
        receive_until(lcm, now() + 0.2, false);
        bool hears = now() - (m->shown.heard ? m->shown.heard_at : since) < silence;
        if (hears != heard) fprintf(stderr, "trocar-top: %s\n", hears ? "a server is heard" : "no server was heard: does it run with the same LCM URL?");
        heard = hears;
        if (m->udp.error == error) continue;
        char text[400];
        udp_json_describe(&m->udp, text, sizeof text);
        fprintf(stderr, "trocar-top: %s\n", text);
        error = m->udp.error;
    }
    return EXIT_SUCCESS;
}

static int print_each_second(lcm_t *lcm, const monitor *d) {
    while (!interrupted) {
        receive_until(lcm, now() + 1.0, false);
        if (!interrupted) print_lines(d);
    }
    return EXIT_SUCCESS;
}

static void draw(const monitor *m) {
    static dashboard_line lines[DASHBOARD_LINES + 1];
    int count = draw_lines(m, LINES, lines);
    erase();
    for (int i = 0; i < count; i++) {
        if (lines[i].alarm) attron(A_BOLD | COLOR_PAIR(1));
        mvaddnstr(i, 0, lines[i].text, COLS);
        attrset(A_NORMAL);
    }
    refresh();
}

static int show(lcm_t *lcm, monitor *m) {
    cbreak();
    noecho();
    nodelay(stdscr, TRUE);
    curs_set(0);
    if (start_color() == OK && use_default_colors() == OK) init_pair(1, COLOR_RED, -1);
    for (int key = 0; key != 'q' && !interrupted; key = getch()) {
        if (key == 'c') dashboard_clear(&m->shown);
        draw(m);
        receive_until(lcm, now() + 0.2, true);
    }
    endwin();
    return EXIT_SUCCESS;
}

/* Opens the screen. Returns false if input and output are not a terminal with cursor control. */
static bool open_screen(const options *o) {
    if (o->plain || o->once || !isatty(STDIN_FILENO) || !isatty(STDOUT_FILENO)) return false;
    if (!newterm(NULL, stdout, stdin)) return false;
    bool can_move = tigetstr("cup") != NULL && tigetstr("cup") != (char *)-1;
    if (!can_move) endwin();
    return can_move;
}

static int run(const options *o, monitor *m, trocar_error *why) {
    if (o->udp && udp_json_open(&m->udp, o->udp, isnan(o->udp_rate) ? UDP_RATE : o->udp_rate, why) != TROCAR_OK) return EXIT_BAD_INPUT;
    m->sends = o->udp;
    lcm_t *lcm = listen_to_server(o, m, why);
    if (!lcm) return EXIT_BAD_INPUT;
    bool quiet = o->udp && !o->plain && !isatty(STDOUT_FILENO);
    int status = o->once ? print_once(o, lcm, m) : quiet ? send_only(lcm, m) : open_screen(o) ? show(lcm, m) : print_each_second(lcm, m);
    lcm_destroy(lcm);
    return status;
}

int main(int count, char **arguments) {
    options o = {.wait = 5, .udp_rate = NAN};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    struct sigaction action = {.sa_handler = interrupt};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);

    static monitor m = {.udp.socket = -1};
    trocar_error why = {0};
    int status = run(&o, &m, &why);
    udp_json_close(&m.udp);
    if (why.text[0]) fprintf(stderr, "trocar-top: %s\n", why.text);
    return status;
}
