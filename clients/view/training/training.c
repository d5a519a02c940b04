#define _GNU_SOURCE
#include "view/training/training.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "base/folders.h"
#include "common/timing.h"
#include "lcm_filter.h"

#define CHANNELS "TROCAR_(POSE|WRENCH|COMMAND|CHANGE|REPLY|DEFORMATION|CONTACTS|TRACKS|SEEDS|PROBE|PROBE_WRENCH)"
enum { QUEUE = 16384 /* messages, about five seconds */, ARGUMENTS = 16, NOT_STARTED = 127 };
enum { PASSED, NOT_PASSED, BAD_INPUT }; /* exit statuses of trocar-score; the others mean that something else failed */

/* ---- trocar-score ---- */

/* Starts trocar-score from this program's folder with these NULL-terminated arguments. Writes to `said` the descriptor of an in-memory file that collects its
   output. Returns the process ID, or -1. */
static pid_t start_scorer(const char *const *arguments, int *said) {
    char program[PATH_MAX] = "";
    ssize_t length = readlink("/proc/self/exe", program, sizeof program - 1);
    char *name = length > 0 ? strrchr(program, '/') : NULL;
    if (!name || (size_t)(name - program) + sizeof "/trocar-score" > sizeof program) return -1;
    strcpy(name, "/trocar-score");
    const char *all[ARGUMENTS] = {program};
    for (int i = 0; arguments[i] && i + 2 < ARGUMENTS; i++) all[i + 1] = arguments[i];
    *said = memfd_create("trocar-score", MFD_CLOEXEC);
    if (*said < 0) return -1;
    pid_t process = fork();
    if (process == 0) {
        setsid(); /* Linux shares CPU time between sessions, so a browser that renders in software cannot starve it */
        dup2(*said, STDOUT_FILENO);
        dup2(*said, STDERR_FILENO);
        execv(program, (char *const *)all);
        dprintf(STDERR_FILENO, "%s: %s: install python3-trocar\n", program, strerror(errno));
        _exit(NOT_STARTED);
    }
    return process;
}

/* Reads what trocar-score has printed, as far as it fits into `text`, and closes the file. */
static void read_said(int said, char *text, size_t size) {
    ssize_t length = pread(said, text, size - 1, 0);
    text[length > 0 ? length : 0] = '\0';
    close(said);
}

/* Returns the last line of a program's output, which says what went wrong, even if warnings or a traceback come before it. Cuts off the newline. */
static const char *last_line(char *said) {
    size_t length = strlen(said);
    while (length > 0 && said[length - 1] == '\n') said[--length] = '\0';
    const char *end = strrchr(said, '\n');
    return end ? end + 1 : said;
}

static int exit_status(int status) { return WIFEXITED(status) ? WEXITSTATUS(status) : NOT_STARTED; }

/* ---- preparing ---- */

/* Copies what follows the key on this line into `value`. Returns false if the line has another key. */
static bool read_key(const char *line, const char *key, char *value, size_t size) {
    size_t length = strlen(key);
    if (strncmp(line, key, length) != 0 || line[length] != ' ') return false;
    snprintf(value, size, "%s", line + length + 1);
    return true;
}

static void read_options(training *t, char *said) {
    char number[64], *rest = NULL;
    for (char *line = strtok_r(said, "\n", &rest); line; line = strtok_r(NULL, "\n", &rest)) {
        if (read_key(line, "scene", t->scene, sizeof t->scene) || read_key(line, "name", t->name, sizeof t->name)
            || read_key(line, "plan", t->plan, sizeof t->plan) || read_key(line, "source", t->source, sizeof t->source)) continue;
        if (read_key(line, "strength", number, sizeof number)) t->strength = strtod(number, NULL);
        else if (read_key(line, "prescription", number, sizeof number)) t->prescription = strtod(number, NULL);
    }
}

static trocar_status make_folders(const char *path, trocar_error *why) {
    char folder[2 * TRAINING_PATH];
    snprintf(folder, sizeof folder, "%s", path);
    return folders_create(folder) ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "--runs: %s: cannot be created: %s", folder, strerror(errno));
}

static trocar_status choose_folder(training *t, const char *runs, trocar_error *why) {
    const char *data = getenv("XDG_DATA_HOME"), *home = getenv("HOME");
    int length = runs ? snprintf(t->runs, sizeof t->runs, "%s", runs)
               : data && *data ? snprintf(t->runs, sizeof t->runs, "%s/trocar/runs", data)
                               : snprintf(t->runs, sizeof t->runs, "%s/.local/share/trocar/runs", home ? home : ".");
    if (length == 0 || length > TRAINING_PATH - 128) return fail(why, TROCAR_BAD_INPUT, "--runs: %s: choose another folder", runs ? runs : t->runs);
    return make_folders(t->runs, why);
}

trocar_status training_prepare(training *t, const char *task, const char *runs, trocar_error *why) {
    char said[4 * TRAINING_PATH];
    int status = 0;
    *t = (training){.task = task};
    trocar_status chosen = choose_folder(t, runs, why);
    if (chosen != TROCAR_OK) return chosen;
    if (!folders_create_temporary("trocar-view", t->prepared, sizeof t->prepared))
        return fail(why, TROCAR_SYSTEM, "cannot make a temporary folder: %s: set TMPDIR", strerror(errno));
    pid_t process = start_scorer((const char *[]){"--task", task, "--prepare", t->prepared, NULL}, &t->said);
    if (process < 0 || waitpid(process, &status, 0) != process) return fail(why, TROCAR_SYSTEM, "cannot start trocar-score: %s", strerror(errno));
    read_said(t->said, said, sizeof said);
    if (exit_status(status) != 0) return fail(why, exit_status(status) == BAD_INPUT ? TROCAR_BAD_INPUT : TROCAR_SYSTEM, "--task: %s", last_line(said));
    read_options(t, said);
    return TROCAR_OK;
}

/* ---- recording ---- */

static void on_message(const lcm_recv_buf_t *received, const char *channel, void *context) {
    training *t = context;
    if (!t->log || t->full) return;
    lcm_eventlog_event_t event = {.eventnum = t->events++, .timestamp = received->recv_utime, .channellen = (int32_t)strlen(channel),
                                  .datalen = (int32_t)received->data_size, .channel = (char *)channel, .data = received->data};
    t->full = lcm_eventlog_write_event(t->log, &event) != 0;
}

trocar_status training_open(training *t, lcm_t *lcm, pilot *hand, trocar_error *why) {
    static const char *const channels[] = {"TROCAR_WRENCH", "TROCAR_TIMING", "TROCAR_STATUS", "TROCAR_CONTACTS", "TROCAR_TRACKS", "TROCAR_DEFORMATION", "TROCAR_SEEDS",
                                           "TROCAR_REPLY", "TROCAR_PROBE_WRENCH", "TROCAR_PROBE", "TROCAR_VALUES", "TROCAR_POSE", "TROCAR_COMMAND", "TROCAR_CHANGE", NULL};
    static const packet_wishes wishes = {.channels = channels}; /* the subscriber's channels, and those that trocar-replay needs */
    if (!t->task) return TROCAR_OK;
    lcm_filter_restrict(&wishes);
    t->lcm = lcm;
    t->hand = hand;
    t->heard = lcm_subscribe(lcm, CHANNELS, on_message, t);
    if (!t->heard) return fail(why, TROCAR_SYSTEM, "cannot subscribe to " CHANNELS);
    lcm_subscription_set_queue_capacity(t->heard, QUEUE);
    return TROCAR_OK;
}

void training_close(training *t) {
    if (t->heard) lcm_unsubscribe(t->lcm, t->heard);
    if (t->log) lcm_eventlog_destroy(t->log);
    if (t->scorer > 0) {
        kill(t->scorer, SIGTERM);
        waitpid(t->scorer, NULL, 0);
        close(t->said);
    }
    if (*t->prepared) folders_remove(t->prepared);
    *t = (training){.task = NULL};
}

/* ---- running ---- */

/* Stores the reason for a refusal, which the page shows. */
static void refuse(training *t, const char *words) { snprintf(t->message, sizeof t->message, "%.500s", words); }

static void give_up_start(training *t, const char *words) {
    refuse(t, words);
    t->state = t->before;
}

/* True if the needle has left tracks or seeds in the tissue. */
static bool is_used(const subscriber *feed, int needle) {
    const trocar_tracks_t *tracks = feed->needles[needle].tracks;
    bool used = tracks && tracks->point_count > 0;
    for (int i = 0; feed->seeds && i < feed->seeds->seed_count; i++) used |= feed->seeds->needle[i] == needle;
    return used;
}

static bool is_tissue_used(const subscriber *feed) {
    bool used = feed->seeds && feed->seeds->seed_count > 0;
    for (int i = 0; i < feed->needle_count; i++) used |= is_used(feed, i);
    return used;
}

static void start_recording(training *t, const subscriber *feed) {
    char path[2 * TRAINING_PATH], stamp[32];
    trocar_error why;
    time_t now = time(NULL);
    struct tm utc;
    strftime(stamp, sizeof stamp, "%Y-%m-%dT%H%M%SZ", gmtime_r(&now, &utc));
    snprintf(path, sizeof path, "%s/%s", t->runs, t->name);
    if (make_folders(path, &why) != TROCAR_OK) {
        give_up_start(t, why.text);
        return;
    }
    snprintf(path, sizeof path, "%s/%s/%s.log", t->runs, t->name, stamp);
    t->log = lcm_eventlog_create(path, "w");
    if (!t->log) {
        give_up_start(t, "The recording cannot be written: see the folder of runs (--runs).");
        return;
    }
    snprintf(t->run, sizeof t->run, "%s/%s", t->name, stamp);
    t->full = t->has_report = false;
    t->events = 0;
    t->began = subscriber_time(feed);
    t->state = TRAINING_RUNNING;
}

/* Returns a used needle that another client holds, or -1. The server would refuse to remove it. */
static int needle_held_elsewhere(const subscriber *feed) {
    for (int i = 0; i < feed->needle_count; i++) {
        int64_t owner = subscriber_owner(feed, i);
        if (is_used(feed, i) && owner != 0 && owner != feed->session) return i;
    }
    return -1;
}

/* Asks the server to remove all used needles and their seeds, unless another client holds one. */
static void ask_to_clear(training *t, const subscriber *feed) {
    int held = needle_held_elsewhere(feed);
    if (held >= 0) {
        char words[96];
        snprintf(words, sizeof words, "Another client holds needle %d: release it there, and try again.", held);
        give_up_start(t, words);
        return;
    }
    for (int i = 0; i < feed->needle_count; i++)
        if (is_used(feed, i)) pilot_clear(t->hand, i);
    t->asked_at = monotonic_ns();
}

void training_start(training *t, subscriber *feed) {
    if (!t->task || (t->state != TRAINING_READY && t->state != TRAINING_SCORED)) return;
    t->before = t->state;
    t->message[0] = '\0';
    t->state = TRAINING_CLEARING;
    t->asked_at = 0;
    training_watch(t, feed);
}

void training_watch(training *t, subscriber *feed) {
    static const int64_t LATEST = 1500000000, PATIENCE = 3000000000; /* ns. A server that has tracks or seeds says so at least once a second: within LATEST */
    int64_t now = monotonic_ns();
    bool replaced = t->server != feed->servers;
    if (replaced) {
        t->server = feed->servers;
        t->server_since = now;
    }
    if (t->state != TRAINING_CLEARING) return;
    if (!subscriber_alive(feed)) give_up_start(t, "There is no server: start trocar-server with the task's scene.");
    else if (replaced && t->asked_at != 0) give_up_start(t, "Another server has started: try again.");
    else if (now - t->server_since < LATEST) return;
    else if (!is_tissue_used(feed)) start_recording(t, feed);
    else if (t->asked_at == 0) ask_to_clear(t, feed);
    else if (now - t->asked_at > PATIENCE) give_up_start(t, "The server did not clear the tissue: release all needles, and try again.");
}

void training_finish(training *t, const subscriber *feed, uint32_t language) {
    static char code[3], log[2 * TRAINING_PATH], html[2 * TRAINING_PATH], json_path[2 * TRAINING_PATH], csv[2 * TRAINING_PATH];
    if (t->state != TRAINING_RUNNING) return;
    lcm_eventlog_destroy(t->log);
    t->log = NULL;
    t->ended = subscriber_time(feed);
    t->state = TRAINING_SCORED;
    if (t->full) {
        refuse(t, "The recording could not be written completely: is the disk full?");
        return;
    }
    snprintf(code, sizeof code, "%c%c", language ? (int)(language & 0x7f) : 'e', language ? (int)(language >> 8 & 0x7f) : 'n');
    snprintf(log, sizeof log, "%s/%s.log", t->runs, t->run);
    snprintf(html, sizeof html, "%s/%s.html", t->runs, t->run);
    snprintf(json_path, sizeof json_path, "%s/%s.json", t->runs, t->run);
    snprintf(csv, sizeof csv, "%s/%s.csv", t->runs, t->run);
    t->scorer = start_scorer((const char *[]){log, "--task", t->task, "--runs", t->runs, "--language", code, "--html", html, "--json", json_path, "--csv", csv, NULL}, &t->said);
    if (t->scorer > 0) t->state = TRAINING_SCORING;
    else refuse(t, "trocar-score cannot be started.");
}

void training_poll(training *t) {
    char said[4 * TRAINING_PATH], page[2 * TRAINING_PATH];
    int status = 0;
    if (t->scorer <= 0 || waitpid(t->scorer, &status, WNOHANG) != t->scorer) return;
    t->scorer = 0;
    t->state = TRAINING_SCORED;
    read_said(t->said, said, sizeof said);
    snprintf(page, sizeof page, "%s/%s.html", t->runs, t->run);
    t->has_report = exit_status(status) <= NOT_PASSED && access(page, R_OK) == 0; /* Python itself exits with 1 after a traceback */
    if (!t->has_report) refuse(t, last_line(said));
}

void training_write(training *t, subscriber *feed, json *j) {
    static const char *const words[] = {"ready", "clearing", "running", "scoring", "scored"};
    if (!t->task) return;
    training_watch(t, feed);
    training_poll(t);
    json_open(j, "task", '{');
    json_text(j, "state", words[t->state]);
    json_number(j, "elapsed", t->state < TRAINING_RUNNING ? 0.0 : (t->state == TRAINING_RUNNING ? subscriber_time(feed) : t->ended) - t->began);
    json_bool(j, "clears", is_tissue_used(feed));
    json_text(j, "report", t->has_report ? t->run : "");
    json_text(j, "message", t->message);
    json_close(j, '}');
}
