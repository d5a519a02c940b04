#include "mapping.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/messages.h"

static const char *const move_names[MOVES] = {"right", "up", "forward", "pitch", "yaw", "roll"};
static const char *const action_names[ACTIONS] = {"clutch", "reset", "leave", "seed", "undo"};

/* Returns the index of the name in the list, or -1. */
static int find(const char *name, const char *const *names, int count) {
    for (int i = 0; i < count && names[i]; i++)
        if (strcmp(name, names[i]) == 0) return i;
    return -1;
}

static void list(const char *const *names, int count, char *text, size_t size) {
    text[0] = '\0';
    for (int i = 0; i < count && names[i]; i++) snprintf(text + strlen(text), size - strlen(text), "%s%s", i > 0 ? ", " : "", names[i]);
}

/* Takes the first NAME=VALUE off `*rest`, with an empty value if there is no '='. Returns false at the end of the list. */
static bool next_pair(const char **rest, char name[32], char value[32]) {
    if (!**rest) return false;
    size_t length = strcspn(*rest, ",");
    char pair[64];
    snprintf(pair, sizeof pair, "%.*s", (int)(length < 63 ? length : 63), *rest);
    char *equals = strchr(pair, '=');
    if (equals) *equals = '\0';
    snprintf(name, 32, "%.31s", pair);
    snprintf(value, 32, "%.31s", equals ? equals + 1 : "");
    *rest += length;
    if (**rest == ',') (*rest)++;
    return true;
}

bool mapping_parse_axes(mapping *m, const char *text, const char *const *axis_names, char *why, size_t size) {
    char name[32], value[32], known[160];
    for (int i = 0; i < MOVES; i++) m->moves[i].axis = -1;
    while (next_pair(&text, name, value)) {
        int move = find(name, move_names, MOVES);
        bool negative = value[0] == '-';
        int axis = find(value + negative, axis_names, INPUT_AXES);
        if (move >= 0 && axis >= 0) {
            m->moves[move].axis = axis;
            m->moves[move].sign = negative ? -1 : 1;
            continue;
        }
        if (move < 0) list(move_names, MOVES, known, sizeof known);
        else list(axis_names, INPUT_AXES, known, sizeof known);
        snprintf(why, size, "'%s' is not one of %s", move < 0 ? name : value, known);
        return false;
    }
    return true;
}

bool mapping_parse_buttons(mapping *m, const char *text, char *why, size_t size) {
    char name[32], value[32], known[160], *end;
    for (int i = 0; i < ACTIONS; i++) m->buttons[i] = -1;
    while (next_pair(&text, name, value)) {
        int action = find(name, action_names, ACTIONS);
        long button = strtol(value, &end, 10);
        if (action < 0) {
            list(action_names, ACTIONS, known, sizeof known);
            snprintf(why, size, "'%s' is not one of %s", name, known);
            return false;
        }
        if (!value[0] || *end || button < 0 || button >= INPUT_BUTTONS) {
            snprintf(why, size, "%s='%s': expected the number of a button, 0 to %d", name, value, INPUT_BUTTONS - 1);
            return false;
        }
        m->buttons[action] = (int)button;
    }
    return true;
}

static double share(const mapping *m, const input_state *state, move_kind move) {
    if (m->moves[move].axis < 0) return 0;
    double a = m->moves[move].sign * state->axes[m->moves[move].axis];
    return copysign(fmax(0, (fabs(a) - m->dead_zone) / (1 - m->dead_zone)), a);
}

/* Mind the sign: in the home pose, the needle's x axis points to the user's left. */
rate_control_command mapping_command(const mapping *m, const input_state *state) {
    return (rate_control_command){.right = -share(m, state, MOVE_RIGHT), .up = share(m, state, MOVE_UP), .forward = share(m, state, MOVE_FORWARD),
                                  .pitch = -share(m, state, MOVE_PITCH), .yaw = share(m, state, MOVE_YAW), .roll = share(m, state, MOVE_ROLL)};
}

double axial_push(const double force[3], quat orientation) { return -v3_dot(load_vec3(force), q_axis(orientation)); }
