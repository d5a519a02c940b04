#include "joystick.h"

#include <errno.h>
#include <fcntl.h>
#include <glob.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <libevdev/libevdev.h>

static const unsigned short LASTS = 100; /* ms, duration of the force effect, which is renewed every 20 ms; if this program hangs, the force stops
                                            after this time */

static const char *const names[] = {"x", "y", "z", "rx", "ry", "rz", "throttle", "rudder", "hat0x", "hat0y", NULL};
static const unsigned codes[INPUT_AXES] = {ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ, ABS_THROTTLE, ABS_RUDDER, ABS_HAT0X, ABS_HAT0Y};

/* ---- what the user does ------------------------------------------------------------------------------------------- */

/* Returns the key code of button number n. Buttons are numbered as in the kernel's joystick interface (joydev.c): first the codes from BTN_JOYSTICK up, then
   those from BTN_MISC up. */
static unsigned nth_code(unsigned n) {
    const unsigned first = KEY_MAX + 1 - BTN_JOYSTICK;
    return n < first ? BTN_JOYSTICK + n : BTN_MISC + n - first;
}

int joystick_button(const struct libevdev *dev, unsigned code) {
    int number = 0;
    for (unsigned n = 0; n <= KEY_MAX - BTN_MISC && number < INPUT_BUTTONS; n++) {
        if (nth_code(n) == code) return libevdev_has_event_code(dev, EV_KEY, code) ? number : -1;
        number += libevdev_has_event_code(dev, EV_KEY, nth_code(n));
    }
    return -1;
}

static double deflection(const struct input_absinfo *a, double rest) {
    double d = a->value - rest, span = d > 0 ? a->maximum - rest : rest - a->minimum;
    return span > 0 ? fmax(-1, fmin(1, d / span)) : 0;
}

void joystick_state(const joystick *j, input_state *state) {
    const struct libevdev *dev = j->dev;
    for (int i = 0; i < INPUT_AXES; i++) {
        const struct input_absinfo *a = libevdev_get_abs_info(dev, codes[i]);
        state->axes[i] = a ? deflection(a, j->rest[i]) : 0;
    }
    memset(state->held, 0, sizeof state->held);
    int number = 0;
    for (unsigned n = 0; n <= KEY_MAX - BTN_MISC && number < INPUT_BUTTONS; n++)
        if (libevdev_has_event_code(dev, EV_KEY, nth_code(n))) state->held[number++] = libevdev_get_event_value(dev, EV_KEY, nth_code(n));
}

/* Records the axes' current values as their rest values, because triggers rest at one end of their range and sticks in the middle. */
static void take_rest(joystick *j) {
    memset(j->moved, 0, sizeof j->moved);
    for (int i = 0; i < INPUT_AXES; i++) j->rest[i] = libevdev_get_event_value(j->dev, EV_ABS, codes[i]);
}

/* Corrects the rest value of a stick with the range 0 to 255. Until its first report, such a stick reads 0, like a trigger at rest. Its first report jumps to
   near the middle of the range, which a trigger reaches only in small steps. */
static void correct_rest(joystick *j, unsigned code, int value) {
    for (int i = 0; i < INPUT_AXES; i++) {
        if (codes[i] != code || j->moved[i]) continue;
        const struct input_absinfo *a = libevdev_get_abs_info(j->dev, code);
        double middle = 0.5 * ((double)a->minimum + a->maximum), quarter = 0.25 * ((double)a->maximum - middle);
        bool at_end = j->rest[i] <= a->minimum || j->rest[i] >= a->maximum;
        if (at_end && fabs(value - middle) < quarter) j->rest[i] = value;
        j->moved[i] = true;
    }
}

/* Reads the next event. If the kernel's buffer overflows, libevdev resynchronises to the current values, and button presses made meanwhile are lost. */
static int next_event(struct libevdev *dev, struct input_event *e) {
    int status = libevdev_next_event(dev, LIBEVDEV_READ_FLAG_NORMAL, e);
    while (status == LIBEVDEV_READ_STATUS_SYNC) status = libevdev_next_event(dev, LIBEVDEV_READ_FLAG_SYNC, e);
    return status;
}

static bool read_joystick(void *context, int timeout, input_state *state, char *text, size_t size) {
    joystick *j = context;
    struct input_event e;
    struct pollfd wait = {.fd = j->fd, .events = POLLIN};
    poll(&wait, 1, timeout);
    int status;
    while ((status = next_event(j->dev, &e)) == LIBEVDEV_READ_STATUS_SUCCESS) {
        int button = e.type == EV_KEY && e.value == 1 ? joystick_button(j->dev, e.code) : -1;
        if (button >= 0) state->presses[button]++;
        if (e.type == EV_ABS) correct_rest(j, e.code, e.value);
    }
    joystick_state(j, state);
    if (status == -EAGAIN || status == -EINTR) return true;
    snprintf(text, size, "the joystick is disconnected (%s): the needle stays where it is; trying again every second", strerror(-status));
    return false;
}

/* ---- what the user feels -------------------------------------------------------------------------------------------- */

int joystick_level(const joystick_force *f, double push) {
    double share = push / f->full_force;
    return isfinite(share) ? (int)lround(32767 * fmax(-f->limit, fmin(f->limit, share))) : 0;
}

static void play(joystick *j, int level, bool begin) {
    struct ff_effect effect = {.type = FF_CONSTANT, .id = (int16_t)j->effect, .direction = (uint16_t)lround(j->force.direction * 0x10000 / 360),
                               .replay = {.length = LASTS}, .u.constant = {.level = (int16_t)level}};
    if (ioctl(j->fd, EVIOCSFF, &effect) < 0) {
        if (errno == ENODEV) return; /* the next read will report the loss of the device */
        fprintf(stderr, "trocar-spacemouse: the joystick rejects the force (%s): no force is rendered\n", strerror(errno));
        j->has_force = false;
        return;
    }
    j->effect = effect.id;
    struct input_event start = {.type = EV_FF, .code = (uint16_t)effect.id, .value = begin};
    if (write(j->fd, &start, sizeof start) < 0) return;
}

static void render(void *context, double push) {
    joystick *j = context;
    if (j->has_force) play(j, joystick_level(&j->force, push), true);
}

/* ---- opening and closing ---------------------------------------------------------------------------------------------- */

static bool find_first(char path[512]) {
    glob_t found;
    bool any = glob("/dev/input/by-id/*-event-joystick", 0, NULL, &found) == 0;
    if (any) snprintf(path, 512, "%s", found.gl_pathv[0]);
    globfree(&found);
    return any;
}

static bool open_joystick(void *context, char *text, size_t size) {
    joystick *j = context;
    char path[512];
    if (j->path) snprintf(path, sizeof path, "%s", j->path);
    else if (!find_first(path)) {
        snprintf(text, size, "no joystick in /dev/input/by-id: plug one in, or name it with --joystick=/dev/input/event...; trying again every second");
        return false;
    }
    j->fd = open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC);
    bool writable = j->fd >= 0;
    if (!writable) j->fd = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    int status = j->fd < 0 ? -errno : libevdev_new_from_fd(j->fd, &j->dev);
    if (status < 0) {
        snprintf(text, size, "%s: cannot be opened: %s; trying again every second", path, strerror(-status));
        if (j->fd >= 0) close(j->fd);
        return false;
    }
    bool motors = libevdev_has_event_code(j->dev, EV_FF, FF_CONSTANT);
    j->has_force = motors && writable;
    j->effect = -1;
    take_rest(j);
    snprintf(text, size, "device: %s, %s", libevdev_get_name(j->dev), j->has_force ? "with force feedback" :
             motors ? "without force: no permission to write to it" : "which has no constant force");
    return true;
}

static void close_joystick(void *context) {
    joystick *j = context;
    if (j->effect >= 0) {
        play(j, 0, false);
        ioctl(j->fd, EVIOCRMFF, j->effect);
    }
    libevdev_free(j->dev);
    close(j->fd);
}

const input_driver joystick_driver = {.axis_names = names, .open = open_joystick, .read = read_joystick, .render = render, .close = close_joystick};
