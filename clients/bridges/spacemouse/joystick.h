/* A joystick with force feedback, accessed through libevdev. It renders a constant force, which the kernel ends automatically unless it is
   renewed. */
#ifndef TROCAR_JOYSTICK_H
#define TROCAR_JOYSTICK_H

#include <linux/input.h>

#include "input.h"

struct libevdev;

typedef struct {
    double full_force;       /* N, force on the needle that corresponds to the joystick's full force; a negative value reverses the direction */
    double limit;            /* upper limit of the level, as a fraction (0 to 1) of the joystick's full force */
    double direction;        /* degrees, direction of the force on the stick: 0 is towards the user, 90 left, 180 away from the user, 270 right */
} joystick_force;

typedef struct {
    const char *path;        /* path of the form /dev/input/event...; NULL selects the first joystick in /dev/input/by-id */
    joystick_force force;
    struct libevdev *dev;
    int fd;
    int effect;              /* number of the uploaded effect; -1 if there is none */
    bool has_force;
    int rest[INPUT_AXES];    /* rest values of the axes: normally their values when the device was opened */
    bool moved[INPUT_AXES];  /* true once the axis has moved since the device was opened */
} joystick;

extern const input_driver joystick_driver;

/* Returns the level of a constant effect (-32767 to 32767) that renders the force `push` (N); 0 if `push` is not finite. */
int joystick_level(const joystick_force *f, double push);

/* Updates `state` from libevdev's values. Deflections are measured from the rest value to the ends of the range. Buttons are numbered as in
   jstest. */
void joystick_state(const joystick *j, input_state *state);

/* Returns the index of the button with this key code; -1 if the device has no such button, or too many buttons. */
int joystick_button(const struct libevdev *dev, unsigned code);

#endif
