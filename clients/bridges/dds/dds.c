/* trocar-dds: connects a needle of trocar-server to ROS 2 nodes, or to any other program that uses DDS. */
#include <stdlib.h>
#include <string.h>

#include "common/messages.h"
#include "common/timing.h"
#include "device/playing.h"
#include "shared/options.h"
#include "topics.h"
#include "trocar_client.h"

const char *argp_program_version = "trocar-dds " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

static const double LONGEST_PERIOD = 0.1;   /* s, after this long without a pose, stop sending poses, so that the server's watchdog removes the force */
static const double SILENCE = 2;            /* s, after this long without a pose, release the needle; the server uses the same time */

typedef struct {
    topic_settings topics;
    trocar_client_options client;
    double rate;                            /* Hz */
    bool domain_given;
} options;

/* ---- command line ---- */

enum { OPTION_URL = 256, OPTION_NEEDLE, OPTION_NAMESPACE, OPTION_FRAME, OPTION_WITHOUT_FORCE };

static const struct argp_option option_list[] = {
    {"domain", 'd', "ID", 0, "DDS domain, 0 to 232 (default $ROS_DOMAIN_ID, or 0)", 0},
    {"namespace", OPTION_NAMESPACE, "NAME", 0, "Namespace of the topics pose, wrench and joint_states (default trocar)", 0},
    {"frame", OPTION_FRAME, "ID", 0, "frame_id of the messages: the name of the scene's world frame (default world)", 0},
    {0, 0, 0, 0, "The needle:", 1},
    {"needle", OPTION_NEEDLE, "N", 0, "Index of the needle to hold, from 0 (default 0)", 1},
    {"without-force", OPTION_WITHOUT_FORCE, 0, 0, "Nobody feels the wrench, as with a planner or a tracker: the needle follows the poses rigidly", 1},
    {0, 0, 0, 0, "Connection:", 2},
    {"lcm-url", OPTION_URL, "URL", 0, "LCM network, or udp://HOST:PORT of a server with --listen; the secret is in $TROCAR_SECRET_FILE (default $LCM_DEFAULT_URL)", 2},
    {"rate", 'r', "HZ", 0, "Poses to the server, and messages on each topic, per second (default 1000)", 2},
    {0},
};

/* Parses a valid ROS name: words separated by slashes. A word consists of letters, digits and underscores, and does not begin with a digit. */
static const char *parse_name(const struct argp_state *state, const char *text) {
    static const char letters[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_", all[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_0123456789";
    const char *name = text + (*text == '/'), *word = name;
    bool valid = strlen(name) <= 200;
    for (size_t length; valid; word += length + 1) {
        valid = *word && strchr(letters, *word);
        length = strspn(word, all);
        if (!word[length]) break;
        valid = valid && word[length] == '/';
    }
    if (!valid) argp_error(state, "--namespace %s: expected words of letters, digits and underscores, separated by slashes", text);
    return name;
}

static error_t parse_option(int key, char *text, struct argp_state *state) {
    options *o = state->input;
    const char *domain = getenv("ROS_DOMAIN_ID");
    switch (key) {
    case 'd':
        o->topics.domain = parse_whole(state, "domain", text, 0, DOMAIN_MAX);
        o->domain_given = true;
        break;
    case 'r': o->rate = parse_number(state, "rate", text, 100, 4000); break;
    case OPTION_NAMESPACE: o->topics.name_space = parse_name(state, text); break;
    case OPTION_FRAME: o->topics.frame = text; break;
    case OPTION_NEEDLE: o->client.needle = parse_index(state, "needle", text); break;
    case OPTION_WITHOUT_FORCE: o->client.without_force = 1; break;
    case OPTION_URL: o->client.url = text; break;
    case ARGP_KEY_ARG: argp_error(state, "unexpected argument '%s'", text); break;
    case ARGP_KEY_END:
        if (!o->domain_given && domain && *domain) o->topics.domain = parse_whole(state, "domain (from $ROS_DOMAIN_ID)", domain, 0, DOMAIN_MAX);
        break;
    default: return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

static const struct argp parser = {
    option_list, parse_option, NULL,
    "Connects a needle of trocar-server to ROS 2, over DDS and without ROS: poses of its base come in (geometry_msgs/PoseStamped), wrenches (WrenchStamped) and "
    "joint states go out, with the quality of service of sensor data.\vThe needle is held from the first pose on, and released when poses have been missing "
    "for two seconds.", NULL, NULL, NULL};

/* ---- the loop ---- */

typedef struct {
    const options *options;
    topics *topics;
    trocar_client *client;
    bool held;
    double heard, period;                   /* s: arrival time of the newest pose, and time since the one before it */
    pose from, to;                          /* where the needle was when the newest pose arrived, and where it is moving to */
} bridge;

static void say(const char *text) { fprintf(stderr, "trocar-dds: %s\n", text); }

/* Interpolates, because poses may arrive at any rate but the server needs one every few milliseconds. The needle takes as long to reach each new pose as
   passed between the last two poses. */
static pose pose_at(const bridge *b, double now) { return pose_between(b->from, b->to, smaller_of(1, (now - b->heard) / b->period)); }

static void take(bridge *b, pose newest, double now) {
    if (!b->held) say("poses arrive: the needle is held");
    b->from = b->held ? pose_at(b, now) : newest;
    b->period = b->held ? larger_of(1 / b->options->rate, smaller_of(now - b->heard, LONGEST_PERIOD)) : LONGEST_PERIOD;
    b->to = newest;
    b->heard = now;
    b->held = true;
}

/* Closes the client, which releases the needle, and opens a new one. */
static trocar_status release(bridge *b, trocar_error *why) {
    say("no poses: the needle is released");
    topics_publish(b->topics, &(needle_state){.base = b->to});
    b->held = false;
    trocar_client_close(b->client);
    b->client = trocar_client_open(&b->options->client, why->text, sizeof why->text);
    return b->client ? TROCAR_OK : TROCAR_SYSTEM;
}

static void exchange(bridge *b, double now) {
    trocar_client_wrench w;
    pose base = pose_at(b, now);
    trocar_pose sent = library_pose(base);
    if (now - b->heard <= LONGEST_PERIOD) trocar_client_publish(b->client, sent.position, sent.orientation);
    trocar_client_newest(b->client, &w); /* all members are zero if there is no server */
    topics_publish(b->topics, &(needle_state){base, {w.force[0], w.force[1], w.force[2]}, {w.torque[0], w.torque[1], w.torque[2]}, w.depth});
}

static trocar_status run(bridge *b, trocar_error *why) {
    double due = playing_now();
    while (!playing_interrupted()) {
        due = larger_of(due + 1 / b->options->rate, playing_now()); /* skip missed periods */
        sleep_until((int64_t)(1e9 * due));
        double now = playing_now();
        pose newest;
        if (topics_take_pose(b->topics, &newest)) take(b, newest, now);
        if (b->held && now - b->heard > SILENCE) {
            trocar_status status = release(b, why);
            if (status != TROCAR_OK) return status;
        }
        if (b->held) exchange(b, now);
    }
    return TROCAR_OK;
}

static trocar_status connect_and_run(const options *o, trocar_error *why) {
    bridge b = {.options = o, .client = trocar_client_open(&o->client, why->text, sizeof why->text)};
    if (!b.client) return TROCAR_BAD_INPUT;
    trocar_status status = topics_open(&o->topics, &b.topics, why);
    if (status == TROCAR_OK) {
        printf("ready\n");
        fflush(stdout);
        status = run(&b, why);
    }
    topics_close(b.topics);
    trocar_client_close(b.client);
    return status;
}

int main(int count, char **arguments) {
    options o = {.rate = 1000, .topics = {.name_space = "trocar", .frame = "world"}};
    argp_parse(&parser, count, arguments, 0, NULL, &o);
    playing_heed_signals();
    trocar_error why;
    trocar_status status = connect_and_run(&o, &why);
    if (status == TROCAR_OK) return EXIT_SUCCESS;
    fprintf(stderr, "trocar-dds: %s\n", why.text);
    return status == TROCAR_BAD_INPUT ? EXIT_BAD_INPUT : EXIT_FAILURE;
}
