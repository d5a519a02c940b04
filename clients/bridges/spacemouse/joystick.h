/* A joystick with force feedback, through libevdev: a constant force, which the kernel ends by itself unless it is renewed. */
#ifndef TROCAR_JOYSTICK_H
#define TROCAR_JOYSTICK_H

#include <linux/input.h>

#include "input.h"

struct libevdev;

typedef struct {
    double full_force;       /* N, force on the needle that is rendered by the joystick's full force; negative: reversed */
    double limit;            /* fraction of the joystick's full force, 0 .. 1, that the level never exceeds */
    double direction;        /* degrees, direction of the force on the stick: 0 towards the user, 90 to the left, 180 away, 270 to the right */
} joystick_force;

typedef struct {
    const char *path;        /* path /dev/input/event...; NULL: the first joystick in /dev/input/by-id */
    joystick_force force;
    struct libevdev *dev;
    int fd;
    int effect;              /* number of the uploaded effect; -1 if there is none */
    bool has_force;
    int rest[INPUT_AXES];    /* values of the axes when the device was opened, which count as rest */
    bool moved[INPUT_AXES];  /* since then */
} joystick;

extern const input_driver joystick_driver;

/* Returns the level of a constant effect, -32767 .. 32767, that renders `push` (N); 0 if `push` is not finite. */
int joystick_level(const joystick_force *f, double push);

/* Updates `state` from libevdev's values. Deflections run from the position at rest to the ends of the range. Buttons are numbered as in jstest. */
void joystick_state(const joystick *j, input_state *state);

/* Returns the index of the button with this key code; -1 if the device has no such button, or too many buttons. */
int joystick_button(const struct libevdev *dev, unsigned code);

#endif
