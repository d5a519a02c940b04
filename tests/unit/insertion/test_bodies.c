/* Tests needles that pass through several bodies and materials, from one body into the next, and out of much stiffer tissue. */
#include "blocks.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "check.h"

static char path[] = "/tmp/trocar-bodies-XXXXXX.msh";

static int setup(void **unused) {
    (void)unused;
    int file = mkstemps(path, 4);
    return file < 0 ? -1 : close(file);
}

static int teardown(void **unused) {
    (void)unused;
    return unlink(path);
}

static pose start_at(double x, double y) { return (pose){v3(x, y, -0.201), {1, 0, 0, 0}}; }

/* ---- from one body into the next ---------------------------------------------------------------------------------------- */

enum { STEPS = 95 }; /* 1 mm steps */
static const double CUTTING = 0.4 + 1.0 * 0.05, FRICTION = 8.0 + 100.0 * 0.05; /* cutting force (N) and friction (N/m), both at 50 mm/s */

/* Inserts by 95 mm and withdraws, both at 50 mm/s. For each millimetre of base travel, records the events and the final force and depth. */
typedef struct { unsigned events[2 * STEPS]; double force[2 * STEPS], depth[2 * STEPS]; } passage;

static void pass(lockstep *l, passage *p) {
    memset(p, 0, sizeof *p);
    for (int i = 0; i < 2 * STEPS; i++) {
        for (int tick = 0; tick < 20; tick++) {
            lockstep_move(l, v3(0, 0, i < STEPS ? 5e-5 : -5e-5), 1e-3, 1e-3);
            p->events[i] |= l->wrench.events;
        }
        p->force[i] = l->wrench.force.z;
        p->depth[i] = l->wrench.depth;
    }
}

static int first(const passage *p, unsigned event, int from) {
    while (from < 2 * STEPS && !(p->events[from] & event)) from++;
    return from;
}

/* Creates two separately meshed bodies. The first is 40 mm thick, the second begins `gap` (m) behind it. With a negative gap, they overlap. */
static lockstep *two_bodies(double gap) {
    block blocks[2] = {{v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.04), {8, 6, 3}, 3, 1, 1, true},
                       {v3(-0.05, -0.04, 0.04 + gap), v3(0.05, 0.04, 0.1 + gap), {7, 5, 4}, 4, 2, 2, false}};
    blocks_write_mesh(path, blocks, 2, 2, 1.0);
    simulation_config c = blocks_config(path, 2);
    for (int r = 0; r < 2; r++) c.regions[r].material.friction_static = c.regions[r].material.friction_kinetic = 8.0;
    return lockstep_create(&c, start_at(0.0031, -0.0027));
}

/* Cutting and friction act on the needle where it is in tissue, but not in the gap. If the first body bulges and closes the gap, nothing changes. A second
   needle in the same track has friction in both bodies but nothing to cut. */
static void second_body_exerts_force(void **unused) {
    (void)unused;
    static const double gaps[] = {0.0, 0.002, 0.015, -0.0005};
    static passage p;
    for (int i = 0; i < 4; i++) {
        lockstep *l = two_bodies(gaps[i]);
        pass(l, &p);
        int left = first(&p, EVENT_EXITED, 0), entered = first(&p, EVENT_TOUCHED, left), last = STEPS - 1;
        double gap = fmax(gaps[i], 0.0), expected = -CUTTING - FRICTION * (p.depth[last] - gap);
        print_message("gap %g mm: out at %d, in at %d mm, %.1f mm deep %.3f N, expected %.3f\n", 1e3 * gaps[i], left, entered, 1e3 * p.depth[last],
                      p.force[last], expected);
        assert_true(left > 35 && left < 60);
        assert_in_range(entered, left, left + (int)(1e3 * gap));
        assert_close(p.force[last] / expected, 1.0, 0.03);
        if (gap > 0.01) assert_close(p.force[entered - 1] / (-FRICTION * 0.04), 1.0, 0.1); /* in the gap, friction acts only in the first body */
        int back = first(&p, EVENT_EXITED, STEPS), out = first(&p, EVENT_WITHDRAWN, back);
        assert_true(back < out && out < 2 * STEPS);
        assert_int_equal(l->state.tip.place.phase, TIP_FREE);
        assert_true(v3_norm(l->wrench.force) == 0.0);
        pass(l, &p);
        int before_end = last - 10;
        assert_close(p.force[before_end] / (-FRICTION * (p.depth[before_end] - gap)), 1.0, 0.03);
        lockstep_free(l);
    }
}

/* A needle that starts inside both bodies feels the friction of both. */
static void engaging_inside_two_bodies(void **unused) {
    (void)unused;
    lockstep *l = two_bodies(0.005);
    pose in = start_at(0.0031, -0.0027);
    in.position.z = -0.2 + 0.08; /* 40 mm in the first body and 35 mm in the second */
    insertion_reset(&l->parts.insertion, in, &l->state);
    l->base = in;
    lockstep_move(l, v3(0, 0, 0), 0.01, 1e-3);
    assert_true(v3_norm(l->wrench.force) < 1e-3);
    assert_close(l->wrench.depth, 0.08, 1e-5);
    lockstep_move(l, v3(0, 0, -0.02), 0.4, 1e-3);
    assert_close(l->wrench.force.z / (FRICTION * (l->wrench.depth - 0.005)), 1.0, 0.03);
    lockstep_free(l);
}

/* Two separately meshed bodies with matching faces are joined into one. */
static void matching_faces_are_joined(void **unused) {
    (void)unused;
    block whole = {v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.1), {6, 5, 5}, 2, 1, 2, true};
    block parts[2] = {{whole.low, v3(0.05, 0.04, 0.04), {6, 5, 2}, 2, 1, 1, true}, {v3(-0.05, -0.04, 0.04), whole.high, {6, 5, 3}, 3, 2, 2, false}};
    mesh one, both;
    trocar_error why;
    blocks_write_mesh(path, &whole, 1, 2, 1.0);
    assert_int_equal(mesh_read(path, &one, &why), TROCAR_OK);
    assert_string_equal(one.remarks.text, "");
    blocks_write_mesh(path, parts, 2, 2, 1.0);
    assert_int_equal(mesh_read(path, &both, &why), TROCAR_OK);
    assert_non_null(strstr(both.remarks.text, "merged 42 duplicate nodes"));
    assert_int_equal(both.node_count, one.node_count);
    assert_int_equal(both.boundary_count, one.boundary_count);
    for (int g = 0; g < one.group_count; g++) assert_int_equal(both.groups[g].node_count, one.groups[g].node_count);
    mesh_free(&one);
    mesh_free(&both);
    parts[1].cells[0] = 5; /* now the nodes coincide only at the two ends */
    blocks_write_mesh(path, parts, 2, 2, 1.0);
    assert_int_equal(mesh_read(path, &both, &why), TROCAR_OK);
    assert_int_equal(both.node_count, 7 * 6 * 3 + 6 * 6 * 4);
    assert_non_null(strstr(both.remarks.text, "12 nodes coincide with others"));
    mesh_free(&both);
}

/* ---- units -------------------------------------------------------------------------------------------------------------- */

static void mesh_unit_is_applied(void **unused) {
    (void)unused;
    block body = {v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.09), {5, 4, 5}, 2, 1, 2, true};
    static const double units[] = {1.0, 1e-2, 1e-3};
    double force[3];
    for (int i = 0; i < 3; i++) {
        blocks_write_mesh(path, &body, 1, 2, units[i]);
        simulation_config c = blocks_config(path, 2);
        c.mesh_unit = units[i];
        lockstep *l = lockstep_create(&c, start_at(0.0031, -0.0027));
        lockstep_move(l, v3(0, 0, 0.04), 0.4, 1e-3);
        force[i] = l->wrench.force.z;
        assert_string_equal(l->parts.mesh.remarks.text, "");
        lockstep_free(l);
        if (i == 0) continue;
        assert_close(force[i] / force[0], 1.0, 1e-6);
        c.mesh_unit = 1.0;
        l = lockstep_create(&c, start_at(0, 0));
        assert_non_null(strstr(l->parts.mesh.remarks.text, "mesh_unit"));
        lockstep_free(l);
    }
    simulation_config c = blocks_config(path, 2); /* the mesh unit is right, but the needle is only 20 um thick */
    c.mesh_unit = 1e-3;
    c.needle.outer_diameter = 20e-6;
    c.needle.inner_diameter = 0.0;
    lockstep *l = lockstep_create(&c, start_at(0, 0));
    assert_non_null(strstr(l->parts.mesh.remarks.text, "much smaller"));
    lockstep_free(l);
}

/* ---- stiff tissue ------------------------------------------------------------------------------------------------------- */

/* Returns the largest change in force per tick, relative to max(7 %, 0.05 N), while the needle is inserted through a layer of this stiffness, moved sideways
   at its base, and withdrawn. */
static double worst_step(double stiffness, unsigned *seen) {
    enum { TICKS = 1200 };
    simulation_config c = blocks_config(path, 2);
    c.regions[1].material.youngs_modulus = stiffness;
    c.needle.bevel_slope = 0.1;
    lockstep *l = lockstep_create(&c, start_at(0.0031, -0.0027));
    vec3 ways[] = {v3(0, 0, 0.065), v3(0.004, 0.006, 0), v3(0, 0, -0.07)}, before = v3(0, 0, 0);
    double worst = 0.0, now = 0.0, at = 0.0;
    for (int part = 0; part < 3; part++)
        for (int tick = 0; tick < TICKS; tick++) { /* starts and stops smoothly */
            lockstep_move(l, v3_scale(M_PI_2 / TICKS * sin(M_PI * (tick + 0.5) / TICKS), ways[part]), 1e-3, 1e-3);
            *seen |= l->wrench.events;
            double step = v3_norm(v3_sub(l->wrench.force, before)) / fmax(0.05, 0.07 * v3_norm(before));
            now += 1e-3;
            if (!(l->wrench.events & EVENT_PUNCTURED) && step > worst) worst = step, at = now;
            before = l->wrench.force;
        }
    print_message("%g Pa: largest step at %.3f s\n", stiffness, at);
    lockstep_free(l);
    return worst;
}

static void force_is_continuous_when_leaving_stiff_tissue(void **unused) {
    (void)unused;
    block body = {v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.09), {8, 7, 9}, 3, 1, 2, true};
    blocks_write_mesh(path, &body, 1, 2, 1.0);
    for (double contrast = 1; contrast <= 1000; contrast *= 10) {
        unsigned seen = 0;
        double worst = worst_step(20e3 * contrast, &seen);
        print_message("%g times stiffer: largest step %.2f of max(7 %%, 0.05 N)\n", contrast, worst);
        assert_false(seen & (EVENT_UNSTABLE | EVENT_FULL));
        assert_true(worst <= 1.0);
    }
}

/* ---- along a side face ---------------------------------------------------------------------------------------------------- */

/* What happens to a needle that is inserted along a side face of the body and withdrawn. */
typedef struct {
    int exits, returns, withdrawals;
    int jumps;               /* ticks in which the force changed by more than max(7 %, 0.05 N), not counting punctures and exits */
    int drops;               /* ticks in which the force dropped to zero, except the last one */
} side_passage;

/* Inserts a needle through the skin, `inside` (m) away from the side face y = -40 mm within the body, and withdraws it. */
static side_passage along_side_face(double inside, double bevel_slope) {
    enum { TICKS = 1500 };
    simulation_config c = blocks_config(path, 2);
    c.needle.bevel_slope = bevel_slope;
    lockstep *l = lockstep_create(&c, start_at(0.0031, -0.04 + inside));
    side_passage p = {.exits = 0};
    vec3 before = v3(0, 0, 0);
    for (int tick = 0; tick < 2 * TICKS; tick++) { /* starts and stops smoothly at both ends */
        double part = (tick % TICKS + 0.5) / TICKS, way = 0.07 * M_PI_2 / TICKS * sin(M_PI * part);
        lockstep_move(l, v3(0, 0, tick < TICKS ? way : -way), 1e-3, 1e-3);
        unsigned events = l->wrench.events;
        p.exits += (events & EVENT_EXITED) != 0;
        p.returns += (events & EVENT_REENTERED) != 0;
        p.withdrawals += (events & EVENT_WITHDRAWN) != 0;
        double step = v3_norm(v3_sub(l->wrench.force, before));
        if (!(events & (EVENT_PUNCTURED | EVENT_EXITED)) && step > fmax(0.05, 0.07 * v3_norm(before))) p.jumps++;
        if (v3_norm(l->wrench.force) == 0.0 && v3_norm(before) > 0.0 && !(events & EVENT_WITHDRAWN)) p.drops++;
        before = l->wrench.force;
    }
    lockstep_free(l);
    return p;
}

/* On the side face or just inside it, the tip must not flip between inside and outside. It may leave the tissue once, and re-enter it once during
   withdrawal. A needle that steers into the tissue does not leave it. */
static void force_is_constant_along_a_side_face(void **unused) {
    (void)unused;
    static const double insides[] = {0.0, 1e-7, 1e-6, 1e-5, 1e-4}, slopes[] = {0.0, 0.1, -0.1};
    block body = {v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.09), {6, 5, 6}, 2, 1, 2, true};
    blocks_write_mesh(path, &body, 1, 2, 1.0);
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < 3; k++) {
            side_passage p = along_side_face(insides[i], slopes[k]);
            print_message("%g um inside, slope %g: %d exits, %d jumps, %d drops\n", 1e6 * insides[i], slopes[k], p.exits, p.jumps, p.drops);
            assert_int_equal(p.jumps, 0);
            assert_int_equal(p.drops, 0);
            assert_true(p.exits <= (slopes[k] < 0.0 ? 0 : 1));
            assert_int_equal(p.returns, p.exits);
            assert_int_equal(p.withdrawals, 1);
        }
}

/* A needle that slides off the edge of the skin is free from then on. The corner of the body that its axis still crosses does not catch it again. */
static void edge_is_crossed_once(void **unused) {
    (void)unused;
    enum { TICKS = 800 };
    block body = {v3(-0.05, -0.04, 0), v3(0.05, 0.04, 0.09), {6, 5, 6}, 2, 1, 2, true};
    blocks_write_mesh(path, &body, 1, 2, 1.0);
    simulation_config c = blocks_config(path, 2);
    for (double tilt = 0.5; tilt < 1.3; tilt += 0.35) {
        vec3 axis = v3(0, -sin(tilt), cos(tilt)), skin = v3(0.0031, -0.0398, 0);
        pose start = {v3_axpy(-0.201, axis, skin), {cos(0.5 * tilt), sin(0.5 * tilt), 0, 0}};
        lockstep *l = lockstep_create(&c, start);
        int touches = 0, falls = 0;
        for (int tick = 0; tick < TICKS; tick++) {
            lockstep_move(l, v3_scale(1e-5, axis), 1e-3, 1e-3);
            touches += (l->wrench.events & EVENT_TOUCHED) != 0;
            falls += (l->wrench.events & EVENT_WITHDRAWN) != 0;
        }
        print_message("at %g rad: %d touches, over the edge %d times\n", tilt, touches, falls);
        assert_int_equal(touches, 1);
        assert_int_equal(falls, 1);
        lockstep_free(l);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(second_body_exerts_force),
        cmocka_unit_test(engaging_inside_two_bodies),
        cmocka_unit_test(matching_faces_are_joined),
        cmocka_unit_test(mesh_unit_is_applied),
        cmocka_unit_test(force_is_continuous_when_leaving_stiff_tissue),
        cmocka_unit_test(force_is_constant_along_a_side_face),
        cmocka_unit_test(edge_is_crossed_once),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
