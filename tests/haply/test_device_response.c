/* Tests that trocar-haply --measure-delay finds the delay and mass of simulated devices. */
#include <stdio.h>

#include "device_response.h"
#include "simulated_device.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const double PERIOD = 1e-3; /* s, between two messages of the bridge */

/* Runs the measurement as the bridge does. `drift`: the hand's voluntary motion, m/s. */
static bool measure(const device_properties *properties, double drift, double reply, response_model *found) {
    static simulated_device device;
    device_response r;
    device_init(&device, properties, v3(0, 0.1, 0), 0.0);
    device_push(&device, v3(0, drift, 0), 0.0, 100.0);
    double now = 0.1;
    for (response_begin(&r, 0.5, now); !response_is_over(&r, now); now += PERIOD) {
        device_apply(&device, now, v3(0, response_force(&r, now), 0));
        response_add(&r, now + reply, device_read(&device, now + reply).y);
    }
    return response_fit(&r, found);
}

static void finds_delay_and_mass(void **unused) {
    (void)unused;
    static const double masses[] = {0.05, 0.1, 0.2, 0.5}, delays[] = {0, 1e-3, 3e-3, 5e-3, 10e-3};
    static const struct { double stiffness, damping; } hands[] = {{300, 3}, {135, 6.45}};
    for (int h = 0; h < 2; h++)
        for (int m = 0; m < 4; m++)
            for (int d = 0; d < 5; d++) {
                device_properties p = {.mass = masses[m], .damping = hands[h].damping, .stiffness = hands[h].stiffness, .delay = delays[d], .resolution = 20e-6};
                response_model found;
                if (!measure(&p, 0.003, 0.2e-3, &found)) fail_msg("mass %g, delay %g: no result", masses[m], delays[d]);
                double off = found.delay - 2 * delays[d];
                if (fabs(off) > 0.5e-3 || fabs(found.mass / masses[m] - 1) > 0.15)
                    fail_msg("mass %g, delay %g each way: found %g kg and %g s there and back, misfit %g", masses[m], delays[d], found.mass, found.delay, found.misfit);
            }
}

static void refuses_what_does_not_move(void **unused) {
    (void)unused;
    response_model found;
    device_properties p = {.mass = 1e6, .damping = 1e6, .stiffness = 1e9, .resolution = 20e-6};
    assert_false(measure(&p, 0.0, 0.0, &found));
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(finds_delay_and_mass), cmocka_unit_test(refuses_what_does_not_move)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
