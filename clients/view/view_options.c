#define _GNU_SOURCE
#include "view_options.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "shared/options.h"

const char *argp_program_version = "trocar-view " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

enum { OPTION_URL = 256, OPTION_BIND, OPTION_SOCKET, OPTION_HOST, OPTION_PAGE, OPTION_LOG, OPTION_PNG, OPTION_AT,
       OPTION_SIZE, OPTION_VIEW, OPTION_CUT, OPTION_THEME, OPTION_SOURCE, OPTION_STRENGTH, OPTION_PRESCRIPTION, OPTION_SWELLING, OPTION_PLAN, OPTION_TASK,
       OPTION_RUNS };

enum { LEAST_SIDE = 320, GREATEST_SIDE = 4096 /* pixels; the page renders at twice the resolution for anti-aliasing */ };

static const struct argp_option option_list[] = {
    {"scene", 's', "FILE", 0, "Scene of the server or of the log (required without --task)", 0},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network (default $LCM_DEFAULT_URL)", 0},
    {0, 0, 0, 0, "Web server:", 1},
    {"port", 'p', "PORT", 0, "TCP port (default 8686; 0: any free one)", 1},
    {"bind", OPTION_BIND, "ADDRESS", 0, "Address to listen on (default 127.0.0.1: this machine only)", 1},
    {"socket", OPTION_SOCKET, "PATH", 0, "Listen on a Unix socket instead, for a proxy", 1},
    {"host", OPTION_HOST, "NAME", 0, "Host name under which the page may be opened, besides localhost and ADDRESS", 1},
    {"page", OPTION_PAGE, "FOLDER", 0, "The built page (default: the one built with this program)", 1},
    {0, 0, 0, 0, "Recorded logs:", 2},
    {"log", OPTION_LOG, "FILE", 0, "Show this LCM event log by simulating its poses in lockstep; needs no network", 2},
    {"png", OPTION_PNG, "FILE", 0, "Write one picture of the log and exit; uses headless Chromium", 2},
    {"at", OPTION_AT, "SECONDS", 0, "Time of the picture after the first pose of the log (default: the end)", 2},
    {"size", OPTION_SIZE, "WIDTHxHEIGHT", 0, "Size of the picture in pixels, 320 to 4096 each (default 1600x1000)", 2},
    {"view", OPTION_VIEW, "NAME", 0, "View: oblique (default), side, above, or along the needle", 2},
    {"cut", OPTION_CUT, "PLANE[:MM]", 0, "Cut the tissue in a sagittal, coronal or axial plane, at MM along x, y or z (default: at the tip)", 2},
    {"theme", OPTION_THEME, "NAME", 0, "Theme: light (default) or dark", 2},
    {0, 0, 0, 0, "Implants, in a scene with a template:", 3},
    {"source", OPTION_SOURCE, "NAME", 0, "Seed model: \"I-125 6711\" (default), \"Pd-103 200\", or the path of a table that ends in .yaml", 3},
    {"strength", OPTION_STRENGTH, "U", 0, "Air-kerma strength of each seed (default 0.5)", 3},
    {"prescription", OPTION_PRESCRIPTION, "GY", 0, "Prescribed dose (default 145)", 3},
    {"swelling", OPTION_SWELLING, "RATIO", 0, "Volume of the simulated gland, taken as swollen, divided by that after the swelling has subsided (default 1.18)", 3},
    {"plan", OPTION_PLAN, "FILE", 0, "Show these planned seeds: the table that python3 -m trocar.brachy.plan show --out writes", 3},
    {0, 0, 0, 0, "Training:", 4},
    {"task", OPTION_TASK, "FILE", 0, "Guide a trainee through this task, record it, and show its report; --scene, --plan and the implant's options come from the task", 4},
    {"runs", OPTION_RUNS, "FOLDER", 0, "The trainee's folder of recordings and reports (default ~/.local/share/trocar/runs)", 4},
    {0},
};

/* Returns the index of `text` in `names`. Exits through argp_error if it is missing. */
static int parse_name(struct argp_state *state, const char *option, const char *text, const char *const *names, int count) {
    int place = 0;
    while (place < count && strcmp(text, names[place]) != 0) place++;
    if (place == count) argp_error(state, "--%s %s: not one of the names in --help", option, text);
    return place;
}

static void parse_size(struct argp_state *state, const char *text, picture *p) {
    int end = 0;
    bool read = sscanf(text, "%5dx%5d%n", &p->width, &p->height, &end) == 2 && text[end] == '\0';
    if (!read || p->width < LEAST_SIDE || p->height < LEAST_SIDE || p->width > GREATEST_SIDE || p->height > GREATEST_SIDE)
        argp_error(state, "--size %s: not WIDTHxHEIGHT with %d to %d pixels each, such as 1600x1000", text, LEAST_SIDE, GREATEST_SIDE);
}

static void parse_cut(struct argp_state *state, const char *text, picture *p) {
    static const char *const planes[] = {"sagittal", "coronal", "axial"};
    char plane[16];
    const char *colon = strchrnul(text, ':');
    snprintf(plane, sizeof plane, "%.*s", (int)(colon - text), text);
    p->cut = "xyz"[parse_name(state, "cut", plane, planes, 3)];
    p->place = *colon ? 1e-3 * parse_number(state, "cut", colon + 1, -1e4, 1e4) : NAN;
}

static error_t parse_implant_option(int key, char *text, struct argp_state *state) {
    view_options *o = state->input;
    implant_settings *i = &o->implant;
    switch (key) {
    case OPTION_SOURCE: i->dose.source = text, o->live_option = "--source"; break;
    case OPTION_STRENGTH: i->dose.strength = parse_number(state, "strength", text, 1e-3, 1000), o->live_option = "--strength"; break;
    case OPTION_PRESCRIPTION: i->dose.prescription = parse_number(state, "prescription", text, 1, 1e4), o->live_option = "--prescription"; break;
    case OPTION_SWELLING: i->dose.swelling = parse_number(state, "swelling", text, 1, 2), o->live_option = "--swelling"; break;
    case OPTION_PLAN: i->plan = text, o->live_option = "--plan"; break;
    case OPTION_TASK: o->task = text, o->live_option = "--task"; break;
    case OPTION_RUNS: o->runs = text; break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static error_t parse_picture_option(int key, char *text, struct argp_state *state) {
    static const char *const views[] = {"oblique", "side", "above", "along"}, *const themes[] = {"light", "dark"};
    view_options *o = state->input;
    switch (key) {
    case OPTION_AT: o->at = parse_number(state, "at", text, 0, 1e6), o->picture_option = "--at"; break;
    case OPTION_SIZE: parse_size(state, text, &o->picture), o->picture_option = "--size"; break;
    case OPTION_VIEW: o->picture.view = 1 + parse_name(state, "view", text, views, 4), o->picture_option = "--view"; break;
    case OPTION_CUT: parse_cut(state, text, &o->picture), o->picture_option = "--cut"; break;
    case OPTION_THEME: o->picture.theme = themes[parse_name(state, "theme", text, themes, 2)], o->picture_option = "--theme"; break;
    default: return parse_implant_option(key, text, state);
    }
    return 0;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    view_options *o = state->input;
    switch (key) {
    case 's': o->scene_path = text; break;
    case 'p': o->web.port = parse_whole(state, "port", text, 0, 65535); break;
    case OPTION_URL: o->lcm_url = text; break;
    case OPTION_BIND: o->web.address = text; break;
    case OPTION_SOCKET: o->web.socket = text; break;
    case OPTION_HOST: o->web.host = text; break;
    case OPTION_PAGE: o->web.page = text; break;
    case OPTION_LOG: o->log_path = text; break;
    case OPTION_PNG: o->png_path = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->scene_path && !o->task) argp_error(state, "--scene is missing");
        if (o->scene_path && o->task) argp_error(state, "--scene: the task names its scene");
        if (o->runs && !o->task) argp_error(state, "--runs needs --task");
        if (o->png_path && !o->log_path) argp_error(state, "--png needs --log");
        if (o->picture_option && !o->png_path) argp_error(state, "%s needs --png", o->picture_option);
        if (o->live_option && o->log_path) argp_error(state, "%s needs a live server, not --log", o->live_option);
        if (o->png_path) o->web.port = 0, o->web.address = o->web.socket = NULL;
        break;
    default: return parse_picture_option(key, text, state);
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Shows a running trocar-server, or a recorded log, in up to 16 browsers, and lets one of them drive a needle.",
    NULL, NULL, NULL};

view_options read_view_options(int count, char **arguments) {
    view_options o = {.at = INFINITY,
                      .implant.dose = {"I-125 6711", 0.5, 145.0, 1.18},
                      .web.port = WEB_PORT,
                      .picture = {.width = 1600, .height = 1000, .view = 1, .theme = "light"}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    return o;
}
