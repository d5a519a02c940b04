#include "spnav_device.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>

#include <spnav.h>

#include "common/timing.h"

/* ns, after this long without an event, all deflections count as zero, because spacenavd before 1.0 does not report that a device has been unplugged */
static const int64_t SILENCE = 500000000;

static const char *const names[] = {"x", "y", "z", "rx", "ry", "rz", NULL};

static bool open_daemon(void *context, char *text, size_t size) {
    spnav_device *d = context;
    char name[128];
    if (spnav_open() != 0) {
        snprintf(text, size, "no spacenavd: start it (Debian: apt install spacenavd), or set SPNAV_SOCKET to its socket; trying again every second");
        return false;
    }
    d->moved = monotonic_ns();
    d->reports_devices = spnav_protocol() >= 1;
    if (!d->reports_devices) {
        snprintf(text, size, "device: spacenavd, protocol 0, which does not say whether there is a device");
        return true;
    }
    spnav_evmask(0); /* switch events off, so that none can come between a request and its response */
    bool present = spnav_dev_name(name, sizeof name) > 0;
    spnav_evmask(SPNAV_EVMASK_DEFAULT);
    if (present) snprintf(text, size, "device: %s", name);
    else snprintf(text, size, "spacenavd has no device: plug one in");
    return true;
}

static void come_to_rest(input_state *state) {
    memset(state->axes, 0, sizeof state->axes);
    memset(state->held, 0, sizeof state->held);
}

static void take_motion(spnav_device *d, const struct spnav_event_motion *m, input_state *state) {
    const int counts[6] = {m->x, m->y, m->z, m->rx, m->ry, m->rz};
    for (int i = 0; i < 6; i++) state->axes[i] = fmax(-1, fmin(1, counts[i] / d->full_scale));
    d->moved = monotonic_ns();
}

static void take_button(const struct spnav_event_button *b, input_state *state) {
    if (b->bnum < 0 || b->bnum >= INPUT_BUTTONS) return;
    state->held[b->bnum] = b->press;
    if (b->press) state->presses[b->bnum]++;
}

static void take_device(const struct spnav_event_dev *e, input_state *state, char *text, size_t size) {
    if (e->op == SPNAV_DEV_ADD) snprintf(text, size, "the device is back");
    else {
        come_to_rest(state);
        snprintf(text, size, "the device is disconnected: the needle stays where it is");
    }
}

/* Checks whether the daemon has closed the connection, because libspnav reports neither that nor read errors. */
static bool is_closed(int socket) {
    char byte;
    ssize_t count = recv(socket, &byte, 1, MSG_PEEK | MSG_DONTWAIT);
    return count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR);
}

static bool read_daemon(void *context, int timeout, input_state *state, char *text, size_t size) {
    spnav_device *d = context;
    spnav_event e;
    struct pollfd wait = {.fd = spnav_fd(), .events = POLLIN};
    if (poll(&wait, 1, timeout) > 0) {
        if (is_closed(wait.fd)) {
            snprintf(text, size, "spacenavd has stopped: the needle stays where it is; trying again every second");
            return false;
        }
        while (spnav_poll_event(&e) != 0)
            if (e.type == SPNAV_EVENT_MOTION) take_motion(d, &e.motion, state);
            else if (e.type == SPNAV_EVENT_BUTTON) take_button(&e.button, state);
            else if (e.type == SPNAV_EVENT_DEV) take_device(&e.dev, state, text, size);
    }
    if (!d->reports_devices && monotonic_ns() - d->moved > SILENCE) memset(state->axes, 0, sizeof state->axes);
    return true;
}

static void close_daemon(void *context) {
    (void)context;
    spnav_close();
}

const input_driver spnav_driver = {.axis_names = names, .open = open_daemon, .read = read_daemon, .close = close_daemon};
