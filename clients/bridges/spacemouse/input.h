/* An input device, read by a thread of its own: a slow driver or a device that is away holds up no poses. */
#ifndef TROCAR_INPUT_H
#define TROCAR_INPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"

enum { INPUT_AXES = 10, INPUT_BUTTONS = 32 };

/* What the user does with the device. */
typedef struct {
    double axes[INPUT_AXES];           /* deflections, -1 .. 1, in the driver's order; 0 at rest and while there is no device */
    bool held[INPUT_BUTTONS];
    uint32_t presses[INPUT_BUTTONS];   /* since the start, so that a short press is not missed */
} input_state;

/* How one kind of device is read. The functions are called from one thread. */
typedef struct {
    const char *const *axis_names;     /* of axes[], NULL after the last */
    /* Opens the device; false, and a reason with the remedy in `text`, if there is none. Otherwise `text` gets its name. */
    bool (*open)(void *device, char *text, size_t size);
    /* Waits for at most `timeout` (ms) and brings `state` up to date; false, and a reason, if the device is gone. `text` stays as it is if
       there is nothing to say. */
    bool (*read)(void *device, int timeout, input_state *state, char *text, size_t size);
    /* Lets the user feel `push` (N), against the direction of forward. NULL: the device has no motors. */
    void (*render)(void *device, double push);
    void (*close)(void *device);       /* motors off */
} input_driver;

typedef struct input input;

/* Starts the thread, which tells on stderr what becomes of the device. It opens the device again whenever it is lost. */
trocar_status input_start(const input_driver *driver, void *device, input **created, report *why);

/* Ends the thread and closes the device, with its motors off. NULL is allowed. */
void input_stop(input *in);

/* The newest state. Call it from one thread only, which also calls input_render. */
const input_state *input_newest(input *in);

/* The force (N) to render from now on. Unless it is renewed within 50 ms it is zero. */
void input_render(input *in, double push);

#endif
