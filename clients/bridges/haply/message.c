#include "message.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <string.h>

static const double REACH = 1.0;              /* m, a cursor farther than this from the device's origin is implausible */
static const double UNIT_TOLERANCE = 0.05;    /* allowed deviation of a quaternion's length from 1 */

static const cJSON *member(const cJSON *object, const char *name) { return cJSON_GetObjectItemCaseSensitive(object, name); }

/* Copies a device's ID. Returns false if it cannot be sent back verbatim in a message. */
static bool read_id(const cJSON *device, char id[HAPLY_ID]) {
    const char *text = cJSON_GetStringValue(member(device, "device_id"));
    if (!text || text[0] == '\0' || strlen(text) >= HAPLY_ID) return false;
    for (const char *c = text; *c; c++)
        if (*c <= ' ' || *c > '~' || *c == '"' || *c == '\\') return false;
    snprintf(id, HAPLY_ID, "%s", text);
    return true;
}

/* Reads the named members of an object. Returns false if one is missing or is not a finite number. */
static bool read_numbers(const cJSON *object, const char *const *names, int count, double *numbers) {
    for (int i = 0; i < count; i++) {
        const cJSON *number = member(object, names[i]);
        if (!cJSON_IsNumber(number) || !isfinite(number->valuedouble)) return false;
        numbers[i] = number->valuedouble;
    }
    return true;
}

static bool read_position(const cJSON *state, vec3 *position) {
    double n[3];
    if (!read_numbers(member(state, "cursor_position"), (const char *[]){"x", "y", "z"}, 3, n)) return false;
    *position = v3(n[0], n[1], n[2]);
    return v3_norm(*position) <= REACH;
}

static bool read_orientation(const cJSON *state, quat *orientation) {
    double n[4];
    if (!read_numbers(member(state, "orientation"), (const char *[]){"w", "x", "y", "z"}, 4, n)) return false;
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] + n[3] * n[3]);
    if (!(fabs(length - 1) <= UNIT_TOLERANCE)) return false;
    *orientation = q_unit((quat){n[0], n[1], n[2], n[3]});
    return true;
}

/* Finds the device with this ID, or the first one if the ID is empty. Returns NULL if there is none. */
static const cJSON *find(const cJSON *list, const char *wanted, char id[HAPLY_ID]) {
    const cJSON *device;
    cJSON_ArrayForEach(device, list)
        if (read_id(device, id) && (wanted[0] == '\0' || strcmp(id, wanted) == 0)) return device;
    id[0] = '\0';
    return NULL;
}

static void read_handle(const cJSON *message, const haply_choice *choice, haply_state *state) {
    static const char *const groups[] = {"wireless_verse_grip", "verse_grip", "custom_verse_grip"};
    for (int i = 0; i < 3; i++) {
        const cJSON *handle = find(member(message, groups[i]), choice->handle, state->handle);
        if (!handle) continue;
        const cJSON *of = member(handle, "state");
        if (!read_orientation(of, &state->orientation)) break;
        state->clutch = cJSON_IsTrue(member(member(of, "buttons"), choice->clutch)) || cJSON_IsTrue(member(of, "button"));
        return;
    }
    state->handle[0] = '\0';
}

static haply_problem read_message(const cJSON *message, const haply_choice *choice, haply_state *state) {
    const cJSON *devices = member(message, "inverse3");
    state->has_session_id = member(message, "session_id") != NULL;
    if (!cJSON_IsObject(message) || (devices && !cJSON_IsArray(devices))) return HAPLY_OTHER_FORMAT;
    const cJSON *device = find(devices, choice->device, state->device);
    if (!device) return HAPLY_NO_DEVICE;
    if (cJSON_IsFalse(member(member(device, "status"), "calibrated"))) return HAPLY_NOT_CALIBRATED;
    if (!read_position(member(device, "state"), &state->position)) return HAPLY_BAD_POSITION;
    read_handle(message, choice, state);
    return HAPLY_GOOD;
}

haply_problem haply_read(const char *text, size_t length, const haply_choice *choice, haply_state *state) {
    *state = (haply_state){.orientation = {1, 0, 0, 0}};
    cJSON *message = cJSON_ParseWithLength(text, length);
    if (!message) return HAPLY_NOT_JSON;
    haply_problem problem = read_message(message, choice, state);
    cJSON_Delete(message);
    return problem;
}

const char *haply_expected(haply_problem problem) {
    switch (problem) {
    case HAPLY_NOT_JSON: return "a message that is incomplete JSON or too long: no force until a complete one arrives";
    case HAPLY_OTHER_FORMAT:
        return "a message in another format; expected \"inverse3\": [...], as of service 3.1 to 3.5 on port 10001 (port 10000 has format 3.0)";
    case HAPLY_NO_DEVICE: return "no such device in the service's list \"inverse3\": connect it, switch it on, or check --device";
    case HAPLY_NOT_CALIBRATED: return "the device is not calibrated: put the handle into its holder until the light is steady";
    case HAPLY_BAD_POSITION: return "no usable state.cursor_position; expected finite x, y, z within 1 m";
    case HAPLY_LATE: return "the service took more than 20 ms to reply: no force until it replies in time";
    case HAPLY_FROZEN: return "exactly the same state for 0.5 s under a force: no force until it changes; is the device still connected to the service?";
    case HAPLY_NO_HANDLE:
        return "no handle with a unit quaternion in wireless_verse_grip, verse_grip or custom_verse_grip: the needle keeps its direction";
    default: return "";
    }
}

bool haply_read_event(const char *text, size_t length, char *told, size_t size) {
    static const char *const worth[] = {"warning", "error", "critical", "panic"};
    cJSON *event = cJSON_ParseWithLength(text, length);
    const char *level = cJSON_GetStringValue(member(event, "level")), *name = cJSON_GetStringValue(member(event, "name"));
    const char *message = cJSON_GetStringValue(member(event, "message"));
    bool tell = false;
    for (int i = 0; level && i < 4; i++) tell = tell || strcmp(level, worth[i]) == 0;
    if (tell) snprintf(told, size, "%s: %s: %s", level, name ? name : "no name", message ? message : "");
    for (char *c = told; tell && *c; c++)
        if (*c < ' ' || *c > '~') *c = '?';
    cJSON_Delete(event);
    return tell;
}

/* Rounds a force (N) to six decimals, towards zero so that it cannot exceed its limits. */
static double six_places(double force) { return trunc(1e6 * force) / 1e6; }

size_t haply_write_force(char *text, size_t size, const char *device, const char *key, vec3 force, bool greet) {
    int length = snprintf(text, size, "{%s\"inverse3\":[{\"device_id\":\"%s\",\"commands\":{\"set_cursor_force\":{\"%s\":{\"x\":%.6f,\"y\":%.6f,\"z\":%.6f}}}}]}",
                          greet ? "\"session\":{\"configure\":{\"profile\":{\"name\":\"trocar-haply\"}}}," : "", device, key,
                          six_places(force.x), six_places(force.y), six_places(force.z));
    return (size_t)length;
}

size_t haply_write_inquiry(char *text, size_t size) {
    return (size_t)snprintf(text, size, "{\"session\":{\"force_render_full_state\":{}}}");
}
