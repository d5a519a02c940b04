/* Messages of the Haply Inverse Service: JSON over WebSocket, port 10001. Written from these pages of https://docs.haply.co/inverseSDK,
   for service 3.5 and for 3.1 to 3.4:

       service/realtime/websocket-protocol   one state for each message sent; the first message lists the devices
       service/api/simulation                the same for 3.1 to 3.4: no session_id, `mode` instead of control_mode
       service/realtime/control-commands     set_cursor_force; commands are forgotten unless they are repeated
       service/commons/json-conventions      groups of devices; ports; unknown keys are ignored
       service/commons/basis                 right-handed, +x right, +y forward, +z up; m, N
       service/tutorials/01 to 06            session.configure.profile.name in the first message only; handles, which point along their local +y

   Uncertain: the key of the force is "vector" in the documentation of 3.5 and "values" in the samples for 3.1 to 3.4; the bridge chooses
   by session_id, which only 3.5 documents. The names of a handle's buttons other than a, b and c are not documented. */
#ifndef TROCAR_HAPLY_MESSAGE_H
#define TROCAR_HAPLY_MESSAGE_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"

enum { HAPLY_ID = 64 };

/* Selects a device and a handle. An empty ID selects the first device or handle in the list. */
typedef struct {
    char device[HAPLY_ID], handle[HAPLY_ID];
    char clutch[HAPLY_ID];   /* name of the button that controls the clutch */
} haply_choice;

/* Verdict on a message. haply_read never returns the last three: only its caller can tell whether a message is late, whether the state is frozen, and
   whether a handle is needed. */
typedef enum {
    HAPLY_GOOD,
    HAPLY_NOT_JSON,
    HAPLY_OTHER_FORMAT,
    HAPLY_NO_DEVICE,
    HAPLY_NOT_CALIBRATED,
    HAPLY_BAD_POSITION,
    HAPLY_LATE,
    HAPLY_FROZEN,
    HAPLY_NO_HANDLE
} haply_problem;

typedef struct {
    char device[HAPLY_ID], handle[HAPLY_ID]; /* IDs of device and handle; empty if there is none */
    vec3 position;           /* m, position of the cursor in the device's frame */
    quat orientation;        /* orientation of the handle in the device's frame */
    bool clutch;             /* true while the clutch button is pressed */
    bool has_session_id;     /* the message comes from service 3.5 or later */
} haply_state;

/* Reads a message. If the verdict is not GOOD, only the members `device` and `has_session_id` of `state` are valid. A handle that is missing, or whose
   quaternion is not of unit length, leaves state->handle empty. The text may be arbitrary: truncated, not JSON at all, or with numbers of any size. */
haply_problem haply_read(const char *text, size_t length, const haply_choice *choice, haply_state *state);

/* Returns a description of what is wrong with the message and what was expected. */
const char *haply_expected(haply_problem problem);

/* Reads an event message of the service (port 10020, service/events). Returns true if its level is warning or higher; `told` then receives level,
   name and message. */
bool haply_read_event(const char *text, size_t length, char *told, size_t size);

/* Each of these functions writes a message into `text`, which has room for `size` bytes, and returns the message's length. `key` is "vector" or
   "values". If `greet` is true, the message also introduces this program to the service, as the first message of a session must. */
size_t haply_write_force(char *text, size_t size, const char *device, const char *key, vec3 force, bool greet);
size_t haply_write_inquiry(char *text, size_t size);  /* writes a message that requests the list of devices */

#endif
