/* Reads an input device in its own thread, so that a slow driver or a missing device does not delay the poses. */
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
    uint32_t presses[INPUT_BUTTONS];   /* how often each button has been pressed since the start, including presses too short to show up in `held` */
} input_state;

/* Driver for one type of device. All its functions are called from the same thread. */
typedef struct {
    const char *const *axis_names;     /* names of the axes in axes[]; NULL after the last name */
    /* Opens the device and writes its name to `text`. If that fails, returns false and writes the reason, and what to do about it, to `text`. */
    bool (*open)(void *device, char *text, size_t size);
    /* Waits up to `timeout` ms for events and updates `state`. If the device is gone, returns false and writes the reason to `text`. Leaves `text` unchanged
       if there is nothing to report. */
    bool (*read)(void *device, int timeout, input_state *state, char *text, size_t size);
    /* Renders a force `push` (N) against the forward direction. NULL if the driver cannot render forces. */
    void (*render)(void *device, double push);
    void (*close)(void *device);       /* switches the motors off and closes the device */
} input_driver;

typedef struct input input;

/* Starts the thread. It tells the user on stderr when the device comes and goes, and reopens it whenever the connection is lost. */
trocar_status input_start(const input_driver *driver, void *device, input **created, trocar_error *why);

/* Ends the thread, switches the motors off and closes the device. NULL is allowed. */
void input_stop(input *in);

/* Returns the newest state. Call this and input_render from one thread only. */
const input_state *input_newest(input *in);

/* Sets the force (N) to render. It drops to zero unless it is renewed within 50 ms. */
void input_render(input *in, double push);

#endif
