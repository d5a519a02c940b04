/* Maps a device's axes to rate commands, and its buttons to actions. */
#ifndef TROCAR_MAPPING_H
#define TROCAR_MAPPING_H

#include "input.h"
#include "shared/rate_control.h"

/* Motions, as seen by a person at the needle in the scene who looks along +z into the body with +y up, so that -x is to the right. */
typedef enum { MOVE_RIGHT, MOVE_UP, MOVE_FORWARD, MOVE_PITCH, MOVE_YAW, MOVE_ROLL, MOVES } move_kind;

typedef enum { ACTION_CLUTCH, ACTION_RESET, ACTION_LEAVE, ACTION_SEED, ACTION_UNDO, ACTIONS } action_kind;

typedef struct {
    struct { int axis; double sign; } moves[MOVES]; /* index into input_state.axes; -1 if no axis is mapped */
    int buttons[ACTIONS];                           /* index into input_state.held; -1 if no button is mapped */
    double dead_zone;                               /* deflections below this fraction of full deflection count as zero */
} mapping;

/* Parses a list such as "forward=-y,right=x". Moves not in the list get no axis. If the list is malformed, returns false and writes the reason to
   `why`. */
bool mapping_parse_axes(mapping *m, const char *text, const char *const *axis_names, char *why, size_t size);

/* Like mapping_parse_axes, for a list of buttons such as "clutch=0,reset=1". */
bool mapping_parse_buttons(mapping *m, const char *text, char *why, size_t size);

/* Returns the rate command for the device's state. Deflections a are measured from the edge of the dead zone d, as (|a| - d) / (1 - d), so that the needle
   starts moving slowly. */
rate_control_command mapping_command(const mapping *m, const input_state *state);

/* Returns the force (N) along the needle axis that a hand feels when it pushes the needle, positive if it opposes the push. force: force from the wrench (N,
   world frame). */
double axial_push(const double force[3], quat orientation);

#endif
