/* A joystick, through libevdev, with force feedback: a constant force that the kernel ends by itself unless it is renewed. */
#ifndef TROCAR_JOYSTICK_H
#define TROCAR_JOYSTICK_H

#include <linux/input.h>

#include "input.h"

struct libevdev;

typedef struct {
    double full_force;       /* N of the needle at the joystick's full force; negative: reversed */
    double limit;            /* fraction of the joystick's full force, 0 .. 1, that is never exceeded */
    double direction;        /* degrees, of the force on the stick: 0 towards the user, 90 to the left, 180 away, 270 to the right */
} joystick_force;

typedef struct {
    const char *path;        /* of /dev/input/event..., NULL: the first joystick in /dev/input/by-id */
    joystick_force force;
    struct libevdev *dev;
    int fd;
    int effect;              /* number of the uploaded effect, -1: none */
    bool has_force;
    int rest[INPUT_AXES];    /* values of the axes at rest: those at opening */
    bool moved[INPUT_AXES];  /* since then */
} joystick;

extern const input_driver joystick_driver;

/* The level of a constant effect, -32767 .. 32767, that renders `push` (N); 0 if it is not finite. */
int joystick_level(const joystick_force *f, double push);

/* Updates `state` from libevdev's values. Deflections are from rest to the ends of the range. Buttons are numbered as in jstest. */
void joystick_state(const joystick *j, input_state *state);

/* Index of the button with this key code, or -1 if the device has no such button or too many. */
int joystick_button(const struct libevdev *dev, unsigned code);

#endif
