/* A joystick with force feedback, accessed through libevdev. Renders a constant force, which the kernel stops by itself unless it is renewed. */
#ifndef TROCAR_JOYSTICK_H
#define TROCAR_JOYSTICK_H

#include <linux/input.h>

#include "input.h"

struct libevdev;

typedef struct {
    double full_force;       /* N, force on the needle that gives the joystick's full force; negative reverses the direction */
    double limit;            /* upper limit on the joystick's force, as a fraction (0 to 1) of its full force */
    double direction;        /* degrees, direction of the force on the stick: 0 is towards the user, 90 left, 180 away from the user, 270 right */
} joystick_force;

typedef struct {
    const char *path;        /* a path such as /dev/input/event5; NULL: the first joystick in /dev/input/by-id */
    joystick_force force;
    struct libevdev *dev;
    int fd;
    int effect;              /* ID of the uploaded effect, or -1 */
    bool has_force;
    int rest[INPUT_AXES];    /* rest values of the axes, usually their values when the device was opened */
    bool moved[INPUT_AXES];  /* true once the axis has moved since the device was opened */
} joystick;

extern const input_driver joystick_driver;

/* Converts a force `push` (N) to the level of a constant effect (-32767 to 32767). Returns 0 if it is not finite. */
int joystick_level(const joystick_force *f, double push);

/* Updates `state` from libevdev. A deflection is 0 at the axis's rest value and 1 or -1 at the ends of its range. Buttons are numbered as in jstest. */
void joystick_state(const joystick *j, input_state *state);

/* Returns the index of the button with this key code, or -1 if the device has no such button or the index would be too large. */
int joystick_button(const struct libevdev *dev, unsigned code);

#endif
