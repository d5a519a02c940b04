/* Maps deflections of a device to rate commands, and its buttons to actions. */
#ifndef TROCAR_MAPPING_H
#define TROCAR_MAPPING_H

#include "input.h"
#include "shared/rate_control.h"

/* As seen by somebody at the scene's needle who looks along +z into the body, with +y up: their right is -x. */
typedef enum { MOVE_RIGHT, MOVE_UP, MOVE_FORWARD, MOVE_PITCH, MOVE_YAW, MOVE_ROLL, MOVES } move_kind;

typedef enum { ACTION_CLUTCH, ACTION_RESET, ACTION_LEAVE, ACTION_SEED, ACTION_UNDO, ACTIONS } action_kind;

typedef struct {
    struct { int axis; double sign; } moves[MOVES]; /* index into input_state.axes, -1: none */
    int buttons[ACTIONS];                           /* index into input_state.held, -1: none */
    double dead_zone;                               /* fraction of the full deflection that counts as none */
} mapping;

/* Parses "forward=-y,right=x"; axes that are not named do not move. False, and a reason, if it is malformed. */
bool mapping_parse_axes(mapping *m, const char *text, const char *const *axis_names, char *why, size_t size);

/* "clutch=0,reset=1", likewise. */
bool mapping_parse_buttons(mapping *m, const char *text, char *why, size_t size);

/* Deflections count from the edge of the dead zone, so that the needle starts slowly: (|a| - d) / (1 - d). */
rate_control_command mapping_command(const mapping *m, const input_state *state);

/* N, the force on a hand that pushes the needle along its axis: positive against the push. `force` (N, world frame) is the wrench's. */
double axial_push(const double force[3], quat orientation);

#endif
