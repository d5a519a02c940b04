/* An input device, which is read in its own thread, so that a slow driver or a missing device does not delay the poses. */
#ifndef TROCAR_INPUT_H
#define TROCAR_INPUT_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"

enum { INPUT_AXES = 10, INPUT_BUTTONS = 32 };

/* The user's input. */
typedef struct {
    double axes[INPUT_AXES];           /* deflections from -1 to 1, in the driver's order; 0 at rest and while no device is connected */
    bool held[INPUT_BUTTONS];
    uint32_t presses[INPUT_BUTTONS];   /* number of presses of each button since the start, including those too short to appear in `held` */
} input_state;

/* Driver for one type of device. All functions are called from the same thread. */
typedef struct {
    const char *const *axis_names;     /* names of the axes in axes[]; NULL after the last name */
    /* Opens the device and writes its name to `text`. If there is none, returns false, and writes the reason and the remedy to `text`. */
    bool (*open)(void *device, char *text, size_t size);
    /* Waits at most `timeout` (ms) for events and updates `state`. If the device has been removed, returns false and writes the reason to `text`. If
       there is nothing to report, leaves `text` unchanged. */
    bool (*read)(void *device, int timeout, input_state *state, char *text, size_t size);
    /* Renders the force `push` (N), which acts against the forward direction. NULL if the device has no motors. */
    void (*render)(void *device, double push);
    void (*close)(void *device);       /* switches the motors off and closes the device */
} input_driver;

typedef struct input input;

/* Starts the thread, which reports the device's state on stderr and reopens the device whenever the connection to it is lost. */
trocar_status input_start(const input_driver *driver, void *device, input **created, trocar_error *why);

/* Ends the thread, switches the motors off and closes the device. NULL is allowed. */
void input_stop(input *in);

/* Returns the newest state. Must be called from a single thread, the one that also calls input_render. */
const input_state *input_newest(input *in);

/* Sets the force (N) to render. The force becomes zero unless it is renewed within 50 ms. */
void input_render(input *in, double push);

#endif
