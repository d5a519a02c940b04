/* trocar-server's main program: options, signals and exit status. */
#include <argp.h>
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/eventfd_signal.h"
#include "condense.h"
#include "exchange.h"
#include "io.h"
#include "lcm_filter.h"
#include "server.h"
#include "trocar.h"

const char *argp_program_version = "trocar-server " TROCAR_VERSION;

enum { KEY_ALLOW_NON_RT = 256, KEY_LISTEN, KEY_SECRET_FILE, KEY_PREPARE, KEY_CONDENSE };

static const struct argp_option options[] = {
    {"scene", 's', "FILE", 0, "Scene to serve (required)", 0},
    {"lcm-url", 'l', "URL", 0, "LCM network (default $LCM_DEFAULT_URL, or udpm://239.255.76.67:7667?ttl=0)", 0},
    {"listen", KEY_LISTEN, "HOST:PORT", 0, "Also serve clients with the URL udp://HOST:PORT, which need no multicast: across subnets, in containers, in WSL2", 0},
    {"secret-file", KEY_SECRET_FILE, "FILE", 0, "Secret that the clients of --listen must know; optional only if HOST is this machine's 127.0.0.1", 0},
    {"rate", 'r', "HZ", 0, "Rate of the loop, overriding the scene's", 0},
    {"allow-non-rt", KEY_ALLOW_NON_RT, NULL, 0, "Run even if real-time priority or memory locking is refused", 0},
    {"prepare", KEY_PREPARE, NULL, 0, "Factorise the whole mesh in the background even if its condensed inverse is cached: this takes gigabytes of memory on "
     "a large mesh, but speeds up pictures of the tissue and makes contacts outside the region of interest possible without a wait", 0},
    {"condense", KEY_CONDENSE, NULL, 0, "Make the scene's condensed inverse, save it in the cache for later starts, and exit", 0},
    {"verbose", 'v', NULL, 0, "Print a line of timing every second", 0},
    {0},
};

typedef struct {
    server_options options;
    bool condense;           /* compute the condensed inverse instead of serving */
    const char *serving;     /* an option that was given but has no effect with --condense; NULL if none */
} arguments;

static const char *option_name(int key) {
    for (const struct argp_option *o = options; o->name; o++)
        if (o->key == key) return o->name;
    return NULL;
}

static error_t parse(int key, char *value, struct argp_state *state) {
    arguments *given = state->input;
    server_options *chosen = &given->options;
    char *end;
    if (key != 's' && key != KEY_CONDENSE && option_name(key)) given->serving = option_name(key);
    switch (key) {
    case 's': chosen->scene_path = value; return 0;
    case 'l': chosen->lcm_url = value; return 0;
    case KEY_LISTEN: chosen->listen = value; return 0;
    case KEY_SECRET_FILE: chosen->secret_file = value; return 0;
    case KEY_PREPARE: chosen->prepare = true; return 0;
    case KEY_CONDENSE: given->condense = true; return 0;
    case 'v': chosen->verbose = true; return 0;
    case KEY_ALLOW_NON_RT: chosen->allow_non_rt = true; return 0;
    case 'r':
        chosen->rate_hz = strtod(value, &end);
        if (*end == '\0' && chosen->rate_hz >= TROCAR_MIN_RATE && chosen->rate_hz <= TROCAR_MAX_RATE) return 0;
        argp_error(state, "--rate %s: give a number of Hz from %g to %g", value, TROCAR_MIN_RATE, TROCAR_MAX_RATE);
        return EINVAL;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument \"%s\"", value); return EINVAL;
    case ARGP_KEY_END:
        if (chosen->scene_path == NULL) argp_error(state, "--scene FILE is missing");
        if (chosen->secret_file && !chosen->listen) argp_error(state, "--secret-file has no effect without --listen");
        if (given->condense && given->serving) argp_error(state, "--%s has no effect with --condense, which serves no client", given->serving);
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static int stop_wake = -1;

static void on_stop(int signal) {
    (void)signal;
    int error = errno;
    eventfd_signal(stop_wake);
    errno = error;
}

/* Signals that would otherwise end the process at once, without ramping the wrench down. Excludes those that report a fault in the program itself. Under nohup,
   SIGHUP remains ignored. */
static const int STOPPING[] = {SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM, SIGPROF, SIGIO, SIGPWR, SIGSTKFLT, SIGXCPU};
static const int IGNORED[] = {SIGPIPE, SIGXFSZ}; /* if whoever reads the output has exited, or the file is full, lose only the output */

/* Returns a descriptor that becomes readable when one of these signals arrives. A signalfd would not do, because threads that libraries start before main do
   not block the signals, so this uses a handler. */
static int stop_signals(void) {
    stop_wake = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    const struct sigaction stop = {.sa_handler = on_stop}, ignore = {.sa_handler = SIG_IGN};
    struct sigaction before;
    for (size_t i = 0; i < sizeof STOPPING / sizeof *STOPPING; i++) sigaction(STOPPING[i], &stop, STOPPING[i] == SIGHUP ? &before : NULL);
    if (before.sa_handler == SIG_IGN) sigaction(SIGHUP, &ignore, NULL);
    for (size_t i = 0; i < sizeof IGNORED / sizeof *IGNORED; i++) sigaction(IGNORED[i], &ignore, NULL);
    return stop_wake;
}

static void say_ready(void) {
    puts("ready");
    fflush(stdout);
}

/* Prints the reason and returns the exit status. Statuses 2 (bad input) and 4 (insufficient privileges, as for LSB services) tell a supervisor that restarting
   won't help. */
static int complain(trocar_status status, const trocar_error *why) {
    fprintf(stderr, "trocar-server: %s\n", why->text);
    switch (status) {
    case TROCAR_BAD_INPUT: return 2;
    case TROCAR_NO_REALTIME: return 4;
    default: return 1;
    }
}

int main(int argc, char **argv) {
    static const struct argp description = {
        options, parse, NULL, "Real-time needle insertion over LCM: TROCAR_POSE in, TROCAR_WRENCH out.", NULL, NULL, NULL};
    arguments given = {0};
    trocar_error why;
    argp_err_exit_status = 2;
    argp_parse(&description, argc, argv, 0, NULL, &given);
    if (given.condense) {
        trocar_status made = condense_scene(given.options.scene_path, stdout, &why);
        return made == TROCAR_OK ? 0 : complain(made, &why);
    }

    server *s;
    int signals = stop_signals();
    lcm_filter_restrict(&IO_PACKETS);
    trocar_status status = server_create(&given.options, &s, &why);
    if (status != TROCAR_OK) return complain(status, &why);
    server_describe(s, stdout);
    status = server_run(s, signals, say_ready, &why);
    if (status == TROCAR_OK) server_summarise(s, stdout);
    int exit_status = status == TROCAR_OK ? 0 : complain(status, &why);
    if (server_busy(s)) { /* a thread is still using the libraries, so exit without cleaning up */
        fflush(NULL);
        _exit(exit_status);
    }
    server_free(s);
    return exit_status;
}
