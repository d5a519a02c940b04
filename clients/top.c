/* trocar-top: timing, faults and guards of a running trocar-server, live in a terminal. */
#include <curses.h>
#include <lcm/lcm.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "dashboard.h"
#include "lcm_filter.h"
#include "message_fit.h"
#include "options.h"
#include "base/report.h"
#include "timing.h"

const char *argp_program_version = "trocar-top " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

typedef struct {
    const char *lcm_url;     /* NULL: $LCM_DEFAULT_URL or LCM's default */
    bool plain, once;
    double wait;             /* s for the first message of a server, with --once */
} options;

enum { OPTION_ONCE = 256, OPTION_WAIT };

static const struct argp_option option_list[] = {
    {"lcm-url", 'l', "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {"plain", 'p', 0, 0, "Print lines of text every second; the default where the output is a file or the terminal has no cursor control", 0},
    {"once", OPTION_ONCE, 0, 0, "Print the values once and exit", 0},
    {"wait", OPTION_WAIT, "SECONDS", 0, "With --once, give up when no server has been heard for this long (default 5)", 0},
    {0},
};

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    switch (key) {
    case 'l': o->lcm_url = text; break;
    case 'p': o->plain = true; break;
    case OPTION_ONCE: o->once = true; break;
    case OPTION_WAIT: o->wait = parse_number(state, "wait", text, 0, 1e6); break;
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

static void on_timing(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    dashboard *d = context;
    trocar_loop_timing_t m;
    if (trocar_loop_timing_t_decode(received->data, 0, (int)received->data_size, &m) == (int)received->data_size)
        dashboard_take_timing(d, &m, now());
    else d->foreign++;
}

static void on_status(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    dashboard *d = context;
    trocar_status_t m;
    if (!status_fits(received->data, received->data_size)
        || trocar_status_t_decode(received->data, 0, (int)received->data_size, &m) != (int)received->data_size) {
        d->foreign++;
        return;
    }
    dashboard_take_status(d, &m, now());
    trocar_status_t_decode_cleanup(&m);
}

static lcm_t *listen_to_server(const options *o, dashboard *d, report *why) {
    static const char *const channels[] = {"TROCAR_TIMING", "TROCAR_STATUS", NULL};
    static const packet_wishes wishes = {.channels = channels, .whole_only = true};
    lcm_filter_restrict(&wishes);
    lcm_t *lcm = lcm_create(o->lcm_url);
    if (lcm && lcm_subscribe(lcm, "TROCAR_TIMING", on_timing, d) && lcm_subscribe(lcm, "TROCAR_STATUS", on_status, d)) return lcm;
    fail(why, TROCAR_BAD_INPUT, "LCM cannot use \"%s\": check --lcm-url and the multicast route", o->lcm_url ? o->lcm_url : "its default URL");
    if (lcm) lcm_destroy(lcm);
    return NULL;
}

static volatile sig_atomic_t interrupted;

static void interrupt(int signal) {
    (void)signal;
    interrupted = 1;
}

/* Receives messages until this time, or (with keys) until a key is pressed or the window changes. */
static void receive_until(lcm_t *lcm, double end, bool keys) {
    struct pollfd events[2] = {{.fd = lcm_get_fileno(lcm), .events = POLLIN}, {.fd = STDIN_FILENO, .events = POLLIN}};
    for (double left; (left = end - now()) > 0 && !interrupted;) {
        if (poll(events, keys ? 2 : 1, 1 + (int)(1e3 * left)) < 0) return;
        if (events[0].revents) lcm_handle(lcm);
        if (keys && events[1].revents) return;
    }
}

/* ---- screens ----------------------------------------------------------------------------------------------------- */

static void print_lines(const dashboard *d) {
    static dashboard_line lines[DASHBOARD_LINES];
    int count = dashboard_draw(d, now(), 24, lines);
    for (int i = 0; i < count; i++) printf("%c %s\n", lines[i].alarm ? '!' : ' ', lines[i].text);
    printf("\n");
    fflush(stdout);
}

static int print_once(const options *o, lcm_t *lcm, dashboard *d) {
    double end = now() + o->wait;
    while (!d->heard && now() < end && !interrupted) receive_until(lcm, now() + 0.1, false);
    if (d->heard) receive_until(lcm, now() + 0.3, false);  /* for the status */
    print_lines(d);
    return d->heard ? EXIT_SUCCESS : EXIT_FAILURE;
}

static int print_each_second(lcm_t *lcm, dashboard *d) {
    while (!interrupted) {
        receive_until(lcm, now() + 1.0, false);
        if (!interrupted) print_lines(d);
    }
    return EXIT_SUCCESS;
}

static void draw(const dashboard *d) {
    static dashboard_line lines[DASHBOARD_LINES];
    int count = dashboard_draw(d, now(), LINES, lines);
    erase();
    for (int i = 0; i < count; i++) {
        if (lines[i].alarm) attron(A_BOLD | COLOR_PAIR(1));
        mvaddnstr(i, 0, lines[i].text, COLS);
        attrset(A_NORMAL);
    }
    refresh();
}

static int show(lcm_t *lcm, dashboard *d) {
    cbreak();
    noecho();
    nodelay(stdscr, TRUE);
    curs_set(0);
    if (start_color() == OK && use_default_colors() == OK) init_pair(1, COLOR_RED, -1);
    for (int key = 0; key != 'q' && !interrupted; key = getch()) {
        if (key == 'c') dashboard_clear(d);
        draw(d);
        receive_until(lcm, now() + 0.2, true);
    }
    endwin();
    return EXIT_SUCCESS;
}

/* Opens the screen if it supports drawing, unlike a file or a dumb terminal. */
static bool open_screen(const options *o) {
    if (o->plain || o->once || !isatty(STDIN_FILENO) || !isatty(STDOUT_FILENO)) return false;
    if (!newterm(NULL, stdout, stdin)) return false;
    bool can_move = tigetstr("cup") != NULL && tigetstr("cup") != (char *)-1;
    if (!can_move) endwin();
    return can_move;
}

int main(int count, char **arguments) {
    options o = {.wait = 5};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    struct sigaction action = {.sa_handler = interrupt};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);

    static dashboard d;
    report why;
    lcm_t *lcm = listen_to_server(&o, &d, &why);
    if (!lcm) {
        fprintf(stderr, "trocar-top: %s\n", why.text);
        return EXIT_BAD_INPUT;
    }
    int status = o.once ? print_once(&o, lcm, &d) : open_screen(&o) ? show(lcm, &d) : print_each_second(lcm, &d);
    lcm_destroy(lcm);
    return status;
}
