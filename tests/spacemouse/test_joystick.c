/* Tests the axes, buttons and joystick of trocar-spacemouse. Instead of the kernel's device, libevdev is given a device in memory and a socket, so no
   joystick is needed. If /dev/uinput exists, a virtual joystick is tested as well. */
#define _GNU_SOURCE
#include "joystick.h"

#include <errno.h>
#include <fcntl.h>
#include <glob.h>
#include <linux/uinput.h>
#include <pthread.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <libevdev/libevdev-uinput.h>
#include <libevdev/libevdev.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"
#include "common/timing.h"
#include "mapping.h"

/* ---- a device in memory ---------------------------------------------------------------------------------------------- */

static int ends[2];                     /* driver's end and test's end of a socket pair */
static struct libevdev *memory;         /* the device that was opened, or NULL for a real one */
typedef struct { int uploads, removals; struct ff_effect last; } rendered;
static rendered motors;                 /* protected by `lock`, because the driver may run in a thread */
static int refusal;                     /* errno that the next uploads return, or 0 for success */
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

int __real_libevdev_new_from_fd(int fd, struct libevdev **dev);
int __real_libevdev_next_event(struct libevdev *dev, unsigned flags, struct input_event *e);
int __real_ioctl(int fd, unsigned long request, ...);
int __wrap_libevdev_new_from_fd(int fd, struct libevdev **dev);
int __wrap_libevdev_next_event(struct libevdev *dev, unsigned flags, struct input_event *e);
int __wrap_ioctl(int fd, unsigned long request, ...);

static struct libevdev *make_device(void) {
    struct libevdev *dev = libevdev_new();
    const struct input_absinfo centred = {.minimum = -512, .maximum = 511}, bytes = {.value = 128, .minimum = 0, .maximum = 255},
                               trigger = {.minimum = 0, .maximum = 1023}, unreported = {.minimum = 0, .maximum = 255};
    libevdev_set_name(dev, "Stick");
    libevdev_enable_event_code(dev, EV_ABS, ABS_X, &centred);
    libevdev_enable_event_code(dev, EV_ABS, ABS_Y, &centred);
    libevdev_enable_event_code(dev, EV_ABS, ABS_RX, &unreported);
    libevdev_enable_event_code(dev, EV_ABS, ABS_RZ, &bytes);
    libevdev_enable_event_code(dev, EV_ABS, ABS_Z, &trigger);
    libevdev_enable_event_code(dev, EV_KEY, BTN_MISC, NULL);
    libevdev_enable_event_code(dev, EV_KEY, BTN_TRIGGER, NULL);
    libevdev_enable_event_code(dev, EV_KEY, BTN_TOP, NULL);
    libevdev_enable_event_code(dev, EV_FF, FF_CONSTANT, NULL);
    return dev;
}

int __wrap_libevdev_new_from_fd(int fd, struct libevdev **dev) {
    if (ends[0] == 0) return __real_libevdev_new_from_fd(fd, dev);
    dup2(ends[0], fd); /* makes the opened file's descriptor refer to the socket */
    fcntl(fd, F_SETFL, O_NONBLOCK);
    *dev = memory = make_device();
    return 0;
}

int __wrap_libevdev_next_event(struct libevdev *dev, unsigned flags, struct input_event *e) {
    if (dev != memory) return __real_libevdev_next_event(dev, flags, e);
    ssize_t count = recv(ends[0], e, sizeof *e, MSG_DONTWAIT);
    if (count < 0) return -errno;
    if (count == 0) return -ENODEV;
    libevdev_set_event_value(dev, e->type, e->code, e->value);
    return LIBEVDEV_READ_STATUS_SUCCESS;
}

int __wrap_ioctl(int fd, unsigned long request, ...) {
    va_list arguments;
    va_start(arguments, request);
    void *argument = va_arg(arguments, void *);
    va_end(arguments);
    if (memory == NULL) return __real_ioctl(fd, request, argument);
    if (request == EVIOCSFF && refusal) return errno = refusal, -1;
    pthread_mutex_lock(&lock);
    motors.removals += request == EVIOCRMFF;
    if (request == EVIOCSFF) {
        struct ff_effect *effect = argument;
        if (effect->id < 0) effect->id = 5;
        motors.last = *effect;
        motors.uploads++;
    }
    pthread_mutex_unlock(&lock);
    return 0;
}

static rendered so_far(void) {
    pthread_mutex_lock(&lock);
    rendered r = motors;
    pthread_mutex_unlock(&lock);
    return r;
}

static int level_now(void) { return so_far().last.u.constant.level; }

static void send_event(unsigned type, unsigned code, int value) {
    struct input_event e = {.type = (uint16_t)type, .code = (uint16_t)code, .value = value};
    assert_int_equal(send(ends[1], &e, sizeof e, 0), sizeof e);
}

/* Returns the last request to play or stop the effect, or -1 if there was none. */
static int played(void) {
    int value = -1;
    for (struct input_event e; recv(ends[1], &e, sizeof e, MSG_DONTWAIT) == sizeof e;)
        if (e.type == EV_FF && e.code == 5) value = e.value;
    return value;
}

static joystick open_stick(void) {
    joystick j = {.path = "/dev/zero", .force = {.full_force = 10, .limit = 0.5}};
    char text[256];
    motors = (rendered){0};
    assert_int_equal(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends), 0);
    assert_true(joystick_driver.open(&j, text, sizeof text));
    assert_string_equal(text, "device: Stick, with force feedback");
    return j;
}

static void close_stick(joystick *j) {
    joystick_driver.close(j);
    memory = NULL;
    close(ends[0]), close(ends[1]);
    ends[0] = 0;
}

/* ---- tests ------------------------------------------------------------------------------------------------------------ */

static void the_mapping_scales_turns_and_cuts(void **unused) {
    (void)unused;
    mapping m = {.dead_zone = 0.2};
    input_state state = {.axes = {0.6, -0.1, -1, 0.2, 1, -0.6}};
    char why[256] = "";
    assert_true(mapping_parse_axes(&m, "forward=-y,right=x,up=z,pitch=-rx,yaw=ry,roll=rz", joystick_driver.axis_names, why, sizeof why));
    rate_control_command c = mapping_command(&m, &state);
    assert_close(c.right, -0.5, 1e-12);  /* (0.6 - 0.2) / 0.8; the home pose's x axis points to the left */
    assert_close(c.forward, 0, 0);       /* within the dead zone */
    assert_close(c.up, -1, 0);
    assert_close(c.pitch, 0, 1e-12);     /* at the edge of the dead zone */
    assert_close(c.yaw, 1, 0);
    assert_close(c.roll, -0.5, 1e-12);
    assert_true(mapping_parse_axes(&m, "forward=-hat0y", joystick_driver.axis_names, why, sizeof why));
    state.axes[9] = -1;
    c = mapping_command(&m, &state);
    assert_true(c.forward == 1 && c.right == 0 && c.yaw == 0);
    assert_false(mapping_parse_buttons(&m, "jump=1", why, sizeof why));
    assert_string_equal(why, "'jump' is not one of clutch, reset, leave, seed, undo");
}

/* The needle points at 45 degrees between x and z, and the hand feels 2 N along -x, so 2 N cos 45 degrees oppose the push. */
static void the_push_is_along_the_needle(void **unused) {
    (void)unused;
    quat q = q_exp(v3(0, 0.25 * M_PI, 0));
    assert_close(axial_push((double[]){0, 0, -3}, (quat){1, 0, 0, 0}), 3, 1e-12);
    assert_close(axial_push((double[]){-2, 7, 0}, q), sqrt(2), 1e-12);
    assert_close(axial_push((double[]){2, 7, 0}, q), -sqrt(2), 1e-12);
}

/* Compares the level for a force (N) that opposes forward motion with a hand calculation. */
static void the_level_is_proportional_and_limited(void **unused) {
    (void)unused;
    joystick_force f = {.full_force = 10, .limit = 0.5};
    assert_int_equal(joystick_level(&f, 0), 0);
    assert_int_equal(joystick_level(&f, 2.5), 8192);    /* a quarter of 32767, rounded */
    assert_int_equal(joystick_level(&f, -2.5), -8192);
    assert_int_equal(joystick_level(&f, 20), 16384);    /* half */
    assert_int_equal(joystick_level(&f, -1e9), -16384);
    assert_int_equal(joystick_level(&f, NAN), 0);
    assert_int_equal(joystick_level(&f, INFINITY), 0);
    f = (joystick_force){.full_force = -10, .limit = 1};
    assert_int_equal(joystick_level(&f, 10), -32767);
    f.limit = 0;
    assert_int_equal(joystick_level(&f, 10), 0);
}

static void axes_and_buttons_arrive(void **unused) {
    (void)unused;
    joystick j = open_stick();
    input_state state = {0};
    char text[256] = "";
    send_event(EV_ABS, ABS_X, 511);
    send_event(EV_ABS, ABS_Y, -256);
    send_event(EV_ABS, ABS_RZ, 255);
    send_event(EV_KEY, BTN_TRIGGER, 1);  /* button 0: codes from BTN_JOYSTICK on come first */
    send_event(EV_KEY, BTN_TOP, 1);
    send_event(EV_KEY, BTN_TOP, 0);      /* button 1: even a short press counts */
    send_event(EV_KEY, BTN_MISC, 1);     /* button 2: codes from BTN_MISC on come last */
    send_event(EV_KEY, BTN_SOUTH, 1);    /* a button the device does not have */
    assert_true(joystick_driver.read(&j, 0, &state, text, sizeof text));
    assert_close(state.axes[0], 1, 0);
    assert_close(state.axes[1], -0.5, 1e-12);  /* 256 of 512 */
    assert_close(state.axes[5], 1, 0);
    assert_close(state.axes[2], 0, 0);
    assert_true(state.held[0] && !state.held[1] && state.held[2] && !state.held[3]);
    assert_true(state.presses[0] == 1 && state.presses[1] == 1 && state.presses[2] == 1 && state.presses[3] == 0);
    assert_string_equal(text, "");
    shutdown(ends[1], SHUT_RDWR); /* unplugged */
    assert_false(joystick_driver.read(&j, 0, &state, text, sizeof text));
    assert_non_null(strstr(text, "the joystick is disconnected"));
    close_stick(&j);
}

static double axis_after(joystick *j, unsigned code, int value, int axis) {
    input_state state = {0};
    char text[256];
    send_event(EV_ABS, code, value);
    assert_true(joystick_driver.read(j, 0, &state, text, sizeof text));
    return state.axes[axis];
}

/* A trigger rests at 0 in a range of 0 .. 1023. A stick that reads 0 because it has not reported anything yet is at rest where its first report says it is. */
static void untouched_axes_are_at_rest(void **unused) {
    (void)unused;
    joystick j = open_stick();
    input_state state = {0};
    char text[256] = "";
    assert_true(joystick_driver.read(&j, 0, &state, text, sizeof text));
    for (int i = 0; i < INPUT_AXES; i++) assert_close(state.axes[i], 0, 0);
    assert_close(axis_after(&j, ABS_Z, 30, 2), 30.0 / 1023, 1e-12);
    assert_close(axis_after(&j, ABS_Z, 512, 2), 512.0 / 1023, 1e-12);
    assert_close(axis_after(&j, ABS_Z, 1023, 2), 1, 0);
    assert_close(axis_after(&j, ABS_Z, 0, 2), 0, 0);
    assert_close(axis_after(&j, ABS_RX, 130, 3), 0, 0);
    assert_close(axis_after(&j, ABS_RX, 0, 3), -1, 0);
    assert_close(axis_after(&j, ABS_RX, 255, 3), 1, 0);
    assert_close(axis_after(&j, ABS_RX, 130, 3), 0, 0);
    close_stick(&j);
}

/* The same effect is uploaded again and again. It ends by itself after 100 ms, and is stopped and removed at the end. */
static void the_force_is_rendered_and_ends(void **unused) {
    (void)unused;
    joystick j = open_stick();
    j.force.direction = 90;
    joystick_driver.render(&j, 2.5);
    assert_true(motors.uploads == 1 && motors.last.type == FF_CONSTANT && motors.last.u.constant.level == 8192);
    assert_true(motors.last.direction == 0x4000 && motors.last.replay.length == 100 && played() == 1); /* to the left */
    joystick_driver.render(&j, 40);
    assert_true(motors.uploads == 2 && motors.last.id == 5 && motors.last.u.constant.level == 16384);
    joystick_driver.render(&j, 0);
    assert_true(motors.last.u.constant.level == 0);
    joystick_driver.render(&j, 5);
    close_stick(&j);
    assert_true(motors.last.u.constant.level == 0 && motors.removals == 1);

    j = open_stick();
    refusal = ENOSPC;
    joystick_driver.render(&j, 1);
    refusal = 0;
    joystick_driver.render(&j, 1);
    assert_int_equal(motors.uploads, 0); /* after the failed upload, the driver renders no more forces */
    close_stick(&j);
}

static double seconds(void) { return 1e-9 * (double)monotonic_ns(); }
static void sleep_for(double duration) { sleep_until(monotonic_ns() + (int64_t)(1e9 * duration)); }

/* The thread renders at most 50 forces per second, and none if the bridge's loop stops or the device is closed. */
static void the_thread_bounds_the_rate_and_lets_go(void **unused) {
    (void)unused;
    joystick j = {.path = "/dev/zero", .force = {.full_force = 10, .limit = 1}};
    input *in;
    trocar_error why;
    motors = (rendered){0};
    assert_int_equal(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends), 0);
    double begin = seconds();
    assert_int_equal(input_start(&joystick_driver, &j, &in, &why), TROCAR_OK);
    int level = 0;
    for (double end = begin + 0.5; seconds() < end; sleep_for(1e-3)) {
        input_render(in, 5);
        if (level_now() > level) level = level_now();
    }
    assert_int_equal(level, 16384);
    double lasted = seconds() - begin;
    int uploads = so_far().uploads;
    print_message("%d forces in %.2f s\n", uploads, lasted);
    assert_true(uploads > 2 && uploads <= lasted / 0.02 + 1);
    sleep_for(0.3);                     /* meanwhile, the loop sends no forces */
    assert_int_equal(level_now(), 0);
    input_render(in, 5);
    sleep_for(0.04);
    input_stop(in);
    assert_true(level_now() == 0 && so_far().removals == 1);
    memory = NULL;
    close(ends[0]), close(ends[1]);
    ends[0] = 0;
}

/* Tests a virtual joystick provided by the kernel. It has no motors, because answering the uploads on uinput's side would take a thread. */
static void a_virtual_joystick_is_read(void **unused) {
    (void)unused;
    int uinput = open("/dev/uinput", O_RDWR | O_CLOEXEC);
    if (uinput < 0) {
        print_message("skipped: /dev/uinput: %s\n", strerror(errno));
        skip();
    }
    struct libevdev *model = make_device();
    struct libevdev_uinput *device;
    libevdev_disable_event_type(model, EV_FF);
    assert_int_equal(libevdev_uinput_create_from_device(model, uinput, &device), 0);
    joystick j = {.path = libevdev_uinput_get_devnode(device)};
    char text[256] = "";
    input_state state = {0};
    for (double end = seconds() + 5; !joystick_driver.open(&j, text, sizeof text); sleep_for(0.01)) assert_true(seconds() < end);
    assert_string_equal(text, "device: Stick, which has no constant force");
    libevdev_uinput_write_event(device, EV_ABS, ABS_X, 511);
    libevdev_uinput_write_event(device, EV_KEY, BTN_TOP, 1);
    libevdev_uinput_write_event(device, EV_SYN, SYN_REPORT, 0);
    for (double end = seconds() + 5; state.axes[0] != 1 && seconds() < end;) assert_true(joystick_driver.read(&j, 20, &state, text, sizeof text));
    assert_true(state.axes[0] == 1 && state.held[1] && state.presses[1] == 1);
    libevdev_uinput_destroy(device);
    assert_false(joystick_driver.read(&j, 1000, &state, text, sizeof text));
    joystick_driver.close(&j);
    libevdev_free(model);
    close(uinput);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_mapping_scales_turns_and_cuts),
        cmocka_unit_test(the_push_is_along_the_needle),
        cmocka_unit_test(the_level_is_proportional_and_limited),
        cmocka_unit_test(axes_and_buttons_arrive),
        cmocka_unit_test(untouched_axes_are_at_rest),
        cmocka_unit_test(the_force_is_rendered_and_ends),
        cmocka_unit_test(the_thread_bounds_the_rate_and_lets_go),
        cmocka_unit_test(a_virtual_joystick_is_read),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
