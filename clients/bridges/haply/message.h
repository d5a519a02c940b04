/* Messages of the Haply Inverse Service: JSON over WebSocket, port 10001. Supports service versions 3.1 to 3.5, according to these pages of
   https://docs.haply.co/inverseSDK:

       service/realtime/websocket-protocol   one state for each message sent; the first message lists the devices
       service/api/simulation                the same for 3.1 to 3.4: no session_id, `mode` instead of control_mode
       service/realtime/control-commands     set_cursor_force; commands are forgotten unless they are repeated
       service/commons/json-conventions      groups of devices; ports; unknown keys are ignored
       service/commons/basis                 right-handed, +x right, +y forward, +z up; m, N
       service/tutorials/01 to 06            session.configure.profile.name in the first message only; handles, which point along their local +y

   Uncertain: the force has the key "vector" in the documentation of 3.5 but "values" in the samples for 3.1 to 3.4. The bridge tells the versions apart by
   session_id, which is documented only for 3.5. Handle buttons other than a, b and c have no documented names. */
#ifndef TROCAR_HAPLY_MESSAGE_H
#define TROCAR_HAPLY_MESSAGE_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"

enum { HAPLY_ID = 64 };

/* Which device and handle to use. An empty ID means the first one in the list. */
typedef struct {
    char device[HAPLY_ID], handle[HAPLY_ID];
    char clutch[HAPLY_ID];   /* name of the button that controls the clutch */
} haply_choice;

/* Verdict on a message. haply_read never returns the last three, because only its caller can tell whether a message is late, the state is frozen, or a
   handle is needed. */
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

/* Parses a message. Unless the verdict is GOOD, only `device` and `has_session_id` are valid in `state`. If the handle is missing or its quaternion is not of
   unit length, state->handle is empty. The text need not be valid: it may be truncated, not JSON at all, or contain numbers of any size. */
haply_problem haply_read(const char *text, size_t length, const haply_choice *choice, haply_state *state);

/* Describes a problem for the user: what is wrong and what was expected. */
const char *haply_expected(haply_problem problem);

/* Parses an event message from the service (port 10020, service/events). If its level is warning or higher, returns true and writes its level, name and
   message to `told`. */
bool haply_read_event(const char *text, size_t length, char *told, size_t size);

/* These functions write a message to `text`, which has room for `size` bytes, and return its length. key: "vector" or "values". greet: also introduce this
   program to the service, which the first message of a session must do. */
size_t haply_write_force(char *text, size_t size, const char *device, const char *key, vec3 force, bool greet);
size_t haply_write_inquiry(char *text, size_t size);  /* requests the list of devices */

#endif
