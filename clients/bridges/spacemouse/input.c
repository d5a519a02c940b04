#include "input.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/triple_buffer.h"
#include "common/timing.h"

static const int PERIOD = 20;                    /* ms between force updates; input from the device is passed on at once */
static const int64_t RETRY = 1000000000;         /* ns between attempts to open the device */
static const int64_t SILENCE = 50000000;         /* ns, the force drops to zero unless it is renewed within this time */

struct input {
    const input_driver *driver;
    void *device;
    pthread_t thread;
    atomic_bool ends;
    triple_buffer states;                        /* input_state */
    _Atomic double push;                         /* N */
    _Atomic int64_t pushed;                      /* ns, monotonic: when the force was last set */
    /* the rest is used only by the thread */
    input_state state;
    char said[512];
};

/* Prints a message unless it is the one last printed. */
static void say(input *in, const char *text) {
    if (strcmp(in->said, text) == 0) return;
    snprintf(in->said, sizeof in->said, "%s", text);
    fprintf(stderr, "trocar-spacemouse: %s\n", text);
}

static void publish(input *in) {
    memcpy(triple_buffer_slot(&in->states), &in->state, sizeof in->state);
    triple_buffer_publish(&in->states);
}

static void render(input *in, int64_t *rendered) {
    int64_t now = monotonic_ns();
    if (!in->driver->render || now - *rendered < PERIOD * INT64_C(1000000)) return;
    bool fresh = now - atomic_load(&in->pushed) < SILENCE;
    in->driver->render(in->device, fresh ? atomic_load(&in->push) : 0);
    *rendered = now;
}

/* Reads input and renders forces for as long as the device is connected. */
static void serve(input *in) {
    char text[512] = "";
    bool there = true;
    for (int64_t rendered = 0; there && !atomic_load(&in->ends);) {
        there = in->driver->read(in->device, PERIOD, &in->state, text, sizeof text);
        if (text[0]) say(in, text);
        publish(in);
        if (there) render(in, &rendered);
    }
    memset(in->state.axes, 0, sizeof in->state.axes); /* stop the needle */
    memset(in->state.held, 0, sizeof in->state.held);
    publish(in);
    in->driver->close(in->device);
}

static void *run(void *context) {
    input *in = context;
    while (!atomic_load(&in->ends)) {
        char text[512] = "";
        bool opened = in->driver->open(in->device, text, sizeof text);
        say(in, text);
        if (opened) serve(in);
        for (int64_t end = monotonic_ns() + RETRY; !atomic_load(&in->ends) && monotonic_ns() < end;) sleep_until(monotonic_ns() + PERIOD * INT64_C(1000000));
    }
    return NULL;
}

trocar_status input_start(const input_driver *driver, void *device, input **created, trocar_error *why) {
    input *in = aligned_alloc(alignof(input), sizeof *in);
    if (!in) return fail(why, TROCAR_NO_MEMORY, "no memory for the input device");
    memset(in, 0, sizeof *in);
    in->driver = driver;
    in->device = device;
    trocar_status status = triple_buffer_create(&in->states, sizeof(input_state), why);
    int error = status == TROCAR_OK ? pthread_create(&in->thread, NULL, run, in) : 0;
    if (error != 0) status = fail(why, TROCAR_SYSTEM, "the input device's thread cannot start: %s", strerror(error));
    if (status == TROCAR_OK) {
        *created = in;
        return TROCAR_OK;
    }
    triple_buffer_free(&in->states);
    free(in);
    return status;
}

void input_stop(input *in) {
    if (!in) return;
    atomic_store(&in->ends, true);
    pthread_join(in->thread, NULL);
    triple_buffer_free(&in->states);
    free(in);
}

const input_state *input_newest(input *in) { return triple_buffer_read(&in->states, NULL); }

void input_render(input *in, double push) {
    atomic_store(&in->push, push);
    atomic_store(&in->pushed, monotonic_ns());
}
