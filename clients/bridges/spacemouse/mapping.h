/* Maps a device's deflections to rate commands, and its buttons to actions. */
#ifndef TROCAR_MAPPING_H
#define TROCAR_MAPPING_H

#include "input.h"
#include "shared/rate_control.h"

/* The motions, as seen by a person at the scene's needle who looks along +z into the body, with +y pointing up: the person's right is -x. */
typedef enum { MOVE_RIGHT, MOVE_UP, MOVE_FORWARD, MOVE_PITCH, MOVE_YAW, MOVE_ROLL, MOVES } move_kind;

typedef enum { ACTION_CLUTCH, ACTION_RESET, ACTION_LEAVE, ACTION_SEED, ACTION_UNDO, ACTIONS } action_kind;

typedef struct {
    struct { int axis; double sign; } moves[MOVES]; /* index into input_state.axes; -1 if no axis is mapped */
    int buttons[ACTIONS];                           /* index into input_state.held; -1 if no button is mapped */
    double dead_zone;                               /* fraction of the full deflection below which a deflection counts as zero */
} mapping;

/* Parses a list such as "forward=-y,right=x"; moves that are not in the list have no axis. If the list is malformed, returns false and writes the
   reason to `why`. */
bool mapping_parse_axes(mapping *m, const char *text, const char *const *axis_names, char *why, size_t size);

/* Parses a list such as "clutch=0,reset=1", in the same way as mapping_parse_axes. */
bool mapping_parse_buttons(mapping *m, const char *text, char *why, size_t size);

/* Returns the rate command for the device's state. Deflections are counted from the edge of the dead zone, as (|a| - d) / (1 - d), so that the needle
   starts to move slowly. */
rate_control_command mapping_command(const mapping *m, const input_state *state);

/* Returns the force (N) along the needle's axis on a hand that pushes the needle; positive if it opposes the push. `force` (N, world frame) is taken
   from the wrench. */
double axial_push(const double force[3], quat orientation);

#endif
