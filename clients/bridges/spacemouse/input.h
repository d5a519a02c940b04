/* An input device that is read by a thread of its own, so that a slow driver or a missing device does not delay the poses. */
#ifndef TROCAR_INPUT_H
#define TROCAR_INPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"

enum { INPUT_AXES = 10, INPUT_BUTTONS = 32 };

/* The user's input. */
typedef struct {
    double axes[INPUT_AXES];           /* deflections from -1 to 1, in the driver's order; 0 at rest and while there is no device */
    bool held[INPUT_BUTTONS];
    uint32_t presses[INPUT_BUTTONS];   /* number of presses since the start, so that a short press is not missed */
} input_state;

/* Driver of one kind of device. The functions are called from one thread. */
typedef struct {
    const char *const *axis_names;     /* names of the axes in axes[], NULL after the last */
    /* Opens the device; `text` receives its name. If there is none, returns false, and `text` receives the reason with the remedy. */
    bool (*open)(void *device, char *text, size_t size);
    /* Waits for at most `timeout` (ms) and updates `state`. If the device is gone, returns false, and `text` receives the reason. `text` is
       unchanged if there is nothing to report. */
    bool (*read)(void *device, int timeout, input_state *state, char *text, size_t size);
    /* Renders the force `push` (N), against the forward direction. NULL if the device has no motors. */
    void (*render)(void *device, double push);
    void (*close)(void *device);       /* motors off */
} input_driver;

typedef struct input input;

/* Starts the thread, which reports the device's state on stderr, and reopens the device whenever it is lost. */
trocar_status input_start(const input_driver *driver, void *device, input **created, report *why);

/* Ends the thread and closes the device, with its motors off. NULL is allowed. */
void input_stop(input *in);

/* Returns the newest state. Call it from one thread only, which also calls input_render. */
const input_state *input_newest(input *in);

/* Sets the force (N) to render. It becomes zero unless it is renewed within 50 ms. */
void input_render(input *in, double push);

#endif
