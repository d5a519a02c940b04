/* An input device, read by its own thread: a slow driver or a missing device delays no poses. */
#ifndef TROCAR_INPUT_H
#define TROCAR_INPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"

enum { INPUT_AXES = 10, INPUT_BUTTONS = 32 };

/* The user's input. */
typedef struct {
    double axes[INPUT_AXES];           /* deflections, -1 .. 1, in the driver's order; 0 at rest and while there is no device */
    bool held[INPUT_BUTTONS];
    uint32_t presses[INPUT_BUTTONS];   /* since the start, so that a short press is not missed */
} input_state;

/* Driver of one kind of device. The functions are called from one thread. */
typedef struct {
    const char *const *axis_names;     /* of axes[], NULL after the last */
    /* Opens the device; false, and a reason with the remedy in `text`, if there is none. Otherwise `text` receives its name. */
    bool (*open)(void *device, char *text, size_t size);
    /* Waits for at most `timeout` (ms) and updates `state`; false, and a reason, if the device is gone. `text` is unchanged if there is nothing to
       report. */
    bool (*read)(void *device, int timeout, input_state *state, char *text, size_t size);
    /* Renders `push` (N), against the direction of forward. NULL: the device has no motors. */
    void (*render)(void *device, double push);
    void (*close)(void *device);       /* motors off */
} input_driver;

typedef struct input input;

/* Starts the thread, which reports the device's state on stderr, and reopens the device whenever it is lost. */
trocar_status input_start(const input_driver *driver, void *device, input **created, report *why);

/* Ends the thread and closes the device, with its motors off. NULL is allowed. */
void input_stop(input *in);

/* The newest state. Call it from one thread only, which also calls input_render. */
const input_state *input_newest(input *in);

/* Sets the force (N) to render. Unless renewed within 50 ms it becomes zero. */
void input_render(input *in, double push);

#endif
