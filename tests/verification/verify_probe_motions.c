/* Checks random probe motions in random scenes: the probe is pressed, lifted, tilted, slid along the surface, rolled and withdrawn, with and without a
   needle in the tissue. The probe must not penetrate the tissue without a force, the forces on probe and needle must be continuous, a hand that returns to
   where it started must not have gained energy, and the probe must stop where its force would exceed the scene's limit.

   usage: verify_probe_motions [--short] FOLDER, or verify_probe_motions --runs FIRST LAST, which prints its findings */
#include <stdarg.h>
#include <time.h>

#include "random_scene.h"
#include "rows.h"

static const double TICK = 1e-3, SLOWEST = 3e-3, FASTEST = 6e-3; /* s, m/s */
static const double NOTICED = 0.07, NOTICED_LEAST = 0.05; /* just noticeable difference in force: as a fraction, and in N */
static const double CLEARANCE = 1e-3; /* m, between the probe and the surface at rest when a motion begins */
static const double UNFELT = 1e-3;    /* N; a smaller force on the probe counts as none */
enum { SET_EVERY = 3, LOOK_EVERY = 100, PARTS = 8, RECOIL = 30 }; /* SET_EVERY: ticks between probe poses; LOOK_EVERY: ticks between checks;
                                                                     PARTS: samples per edge; RECOIL: ticks after a puncture */

typedef enum { WITHOUT, HELD, RESTING } needle_use;

/* What is reported. Most of it is checked against a limit. */
typedef enum { NODE_DEPTH, UNFELT_DEPTH, FACE_DEPTH, JUMP, JUMP_AFTER_STOP, NEEDLE_JUMP, OVERLOAD, FORCE, GAIN, GAIN_WITH_NEEDLE, FINDINGS } finding_kind;

typedef struct {
    double worst;            /* of all runs */
    int above, run;          /* above: values that exceed the limit; run: the run with the worst value */
} finding;

typedef struct {
    int runs, uses[3], unlike, failed, kept, touching_at_last;
    long ticks, looks, pressed, stopped;
    finding of[FINDINGS];
} findings;

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    trocar_probe_shape shape;
    double max_force;        /* N */
    double *displacements;
    int triangle_count;      /* triangles of the surface that the probe presses on */
    int32_t (*triangles)[3];
    trocar_pose asked;       /* of the probe */
    trocar_probe probe;      /* as last solved */
    int needle;              /* the one that is ticked */
    trocar_pose base[2];
    trocar_output last[2];
    int since;               /* ticks since the needle's last puncture or exit */
    double work, most_work;
    long ticks;
    bool moving;             /* the probe */
    findings found;          /* of this run */
    int number;
    bool talks;
} trial;

static const double LIMITS[FINDINGS] = {
    [NODE_DEPTH] = 10e-6,    /* m; nodes are kept out of the probe to 1e-12 m, but needles move them until the next solve */
    [UNFELT_DEPTH] = 0.2929, /* in radii: sagitta of a 90-degree arc; edges may penetrate this deep before they touch (mechanics.md) */
    [FACE_DEPTH] = INFINITY, [FORCE] = INFINITY, [JUMP] = 1.0, [JUMP_AFTER_STOP] = 1.0, [NEEDLE_JUMP] = 1.0, [OVERLOAD] = 1e-3, [GAIN] = 1e-3,
    [GAIN_WITH_NEEDLE] = 1e-3};

enum { MOST_TOLD = 30 };     /* messages of one type that a run prints at most */

/* Returns whether the value exceeds its limit and a message about it should be printed. */
static bool exceeds(trial *t, finding_kind kind, double value) {
    finding *f = &t->found.of[kind];
    if (!(value <= f->worst)) f->worst = value, f->run = t->number;
    if (value <= LIMITS[kind]) return false;
    return ++f->above <= MOST_TOLD && t->talks;
}

static void tell(const trial *t, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Prints a line about an event at this time. */
static void tell(const trial *t, const char *format, ...) {
    va_list arguments;
    printf("run %d, %.3f s: ", t->number, t->ticks * TICK);
    va_start(arguments, format);
    vprintf(format, arguments);
    va_end(arguments);
    printf("\n");
}

static void findings_begin(findings *f) {
    *f = (findings){0};
    for (int k = 0; k < FINDINGS; k++) f->of[k].worst = -INFINITY;
}

static void findings_add(findings *sum, const findings *f) {
    for (int k = 0; k < FINDINGS; k++) {
        finding *to = &sum->of[k];
        int above = to->above + f->of[k].above;
        if (!(f->of[k].worst <= to->worst)) *to = f->of[k];
        to->above = above;
    }
    for (int i = 0; i < 3; i++) sum->uses[i] += f->uses[i];
    sum->runs += f->runs, sum->unlike += f->unlike, sum->failed += f->failed, sum->kept += f->kept, sum->touching_at_last += f->touching_at_last;
    sum->ticks += f->ticks, sum->looks += f->looks, sum->pressed += f->pressed, sum->stopped += f->stopped;
}

/* ---- penetration ---------------------------------------------------------------------------------------------------------------- */

/* Returns how deep (m) a point is inside the probe, negative outside. The solid is a cylinder with a rounded edge: away from the edge, its side or its end
   is closest. It extends without limit behind its base. */
static double depth_in_probe(const trocar_probe_shape *s, const trocar_pose *base, const double x[3]) {
    const double *q = base->orientation, *at = base->position, back[4] = {q[0], -q[1], -q[2], -q[3]}, away[3] = {x[0] - at[0], x[1] - at[1], x[2] - at[2]};
    double local[3];
    quaternion_rotate(back, away, local);
    double r = hypot(local[0], local[1]), edge = s->radius - s->tip_radius, begins = s->length - s->tip_radius;
    if (r > edge && local[2] > begins) return s->tip_radius - hypot(r - edge, local[2] - begins);
    return fmin(s->radius - r, s->length - local[2]);
}

static void look(trial *t) {
    trocar_error why;
    const double *rest = trocar_model_nodes(t->model);
    double nodes = -INFINITY, faces = -INFINITY;
    fail_if(trocar_view_displacements(trocar_sim_view(t->sim), t->displacements, &why), &why);
    for (int k = 0; k < t->triangle_count; k++)
        for (int i = 0; i <= PARTS; i++)
            for (int j = 0; i + j <= PARTS; j++) {
                const double weights[3] = {(double)i / PARTS, (double)j / PARTS, (double)(PARTS - i - j) / PARTS};
                double x[3] = {0, 0, 0};
                for (int c = 0; c < 3; c++)
                    for (int a = 0; a < 3; a++) x[a] += weights[c] * (rest[3 * t->triangles[k][c] + a] + t->displacements[3 * t->triangles[k][c] + a]);
                double depth = depth_in_probe(&t->shape, &t->probe.base, x);
                faces = fmax(faces, depth);
                if (i == PARTS || j == PARTS || i + j == 0) nodes = fmax(nodes, depth);
            }
    double force = length3(t->probe.force);
    t->found.looks++;
    if (exceeds(t, NODE_DEPTH, nodes)) tell(t, "node %.3f mm inside, %.3f N, %d points", 1e3 * nodes, force, t->probe.contacts);
    exceeds(t, FACE_DEPTH, faces / t->shape.radius);
    if (force < UNFELT && exceeds(t, UNFELT_DEPTH, faces / t->shape.radius)) tell(t, "face %.2f mm inside without force, %d points", 1e3 * faces, t->probe.contacts);
}

/* ---- ticks --------------------------------------------------------------------------------------------------------------------- */

/* Returns a change in force in just noticeable differences. */
static double change_of(const double before[3], const double after[3]) {
    return distance3(before, after) / fmax(NOTICED_LEAST, NOTICED * length3(before));
}

static void judge_probe(trial *t, const trocar_probe *now) {
    findings *f = &t->found;
    const trocar_probe *before = &t->probe;
    double force = length3(now->force), change = change_of(before->force, now->force);
    if (!isfinite(force + length3(now->torque) + length3(now->base.position)) || !now->placed) f->failed++;
    double moved = distance3(now->base.position, before->base.position) + distance3(now->base.orientation + 1, before->base.orientation + 1);
    if (t->moving && exceeds(t, before->stopped ? JUMP_AFTER_STOP : JUMP, change))
        tell(t, "probe's jump %.2f, %.3f to %.3f N, %d to %d points, stopped %d to %d, moved by %.3f mm", change, length3(before->force), force, before->contacts,
             now->contacts, before->stopped, now->stopped, 1e3 * distance3(now->base.position, before->base.position));
    exceeds(t, FORCE, force / t->max_force);
    if (moved > 0.0 && force > length3(before->force) && exceeds(t, OVERLOAD, force / t->max_force - 1.0))
        tell(t, "raised to %.4f N, of %.4f N at most, stopped %d", force, t->max_force, now->stopped);
    bool there = distance3(now->base.position, t->asked.position) < 1e-12;
    for (int i = 0; i < 4; i++) there = there && fabs(now->base.orientation[i] - t->asked.orientation[i]) < 1e-12;
    if (there == (now->stopped != 0)) {
        f->unlike++;
        if (t->talks && f->unlike <= MOST_TOLD) tell(t, "stopped %d, but %s where it should be", now->stopped, there ? "it is" : "it is not");
    }
    f->pressed += now->contacts > 0;
    f->stopped += now->stopped;
}

static void judge_needle(trial *t, const trocar_output *out) {
    findings *f = &t->found;
    t->since = out->events & (TROCAR_EVENT_PUNCTURED | TROCAR_EVENT_EXITED) ? 0 : t->since + 1;
    if (out->events & TROCAR_EVENT_UNSTABLE || !isfinite(length3(out->force) + length3(out->torque))) {
        f->failed++;
        if (t->talks && f->failed <= MOST_TOLD) tell(t, "needle unstable");
    }
    if (!t->moving || t->since < RECOIL) return;
    double change = change_of(t->last[t->needle].force, out->force);
    if (exceeds(t, NEEDLE_JUMP, change))
        tell(t, "needle's jump %.2f, %.3f to %.3f N, %.2f mm deep, events %#x, probe %.3f N", change, length3(t->last[t->needle].force), length3(out->force), 1e3 * out->depth,
             out->events, length3(t->probe.force));
}

/* Runs a tick with the needle's base at `base` and the probe at the pose last requested. */
static void tick(trial *t, const trocar_pose *base) {
    trocar_output out;
    trocar_error why;
    int n = t->needle;
    fail_if(trocar_sim_step(t->sim, n, base, TICK, &out, &why), &why);
    trocar_probe now = trocar_view_probe(trocar_sim_view(t->sim));
    t->ticks++;
    judge_needle(t, &out);
    judge_probe(t, &now);
    t->work += hand_work(&t->base[n], t->last[n].force, t->last[n].torque, base, out.force, out.torque);
    t->work += hand_work(&t->probe.base, t->probe.force, t->probe.torque, &now.base, now.force, now.torque);
    t->most_work = fmax(t->most_work, t->work);
    t->base[n] = *base;
    t->last[n] = out;
    t->probe = now;
    if (t->moving && t->ticks % LOOK_EVERY == 0) look(t);
}

static void set_probe(trial *t, const trocar_pose *at) {
    trocar_error why;
    t->asked = *at;
    fail_if(trocar_sim_set_probe(t->sim, at, &why), &why);
}

/* ---- hands --------------------------------------------------------------------------------------------------------------------- */

static void follow(trial *t, const hand_leg *leg) {
    trocar_pose from = t->asked;
    int ticks = (int)ceil(leg->seconds / TICK);
    for (int i = 1; i <= ticks; i++) {
        trocar_pose at = hand_pose(leg, &from, i * TICK);
        if (i % SET_EVERY == 0 || i == ticks) set_probe(t, &at);
        tick(t, &t->base[t->needle]);
    }
}

static void go_home(trial *t, const trocar_pose *home) {
    trocar_pose from = t->asked;
    int ticks = (int)ceil(fmax(0.5, 1.875 * distance3(home->position, from.position) / FASTEST) / TICK);
    for (int i = 1; i <= ticks; i++) {
        double s = (double)i / ticks;
        trocar_pose at = i == ticks ? *home : pose_towards(&from, home, s * s * s * (10 - 15 * s + 6 * s * s));
        set_probe(t, &at);
        tick(t, &t->base[t->needle]);
    }
}

static void push_needle(trial *t, double advance) {
    hand_motion m = {0};
    hand_add(&m, 0.06, (hand_leg){.advance = advance});
    trocar_pose from = t->base[t->needle];
    int ticks = (int)ceil(m.legs[0].seconds / TICK);
    for (int i = 1; i <= ticks; i++) {
        trocar_pose p = hand_pose(&m.legs[0], &from, i * TICK);
        tick(t, &p);
    }
}

/* ---- scenes and motions -------------------------------------------------------------------------------------------------------- */

typedef struct {
    random_scene *block;     /* NULL: meshes/trus.yaml */
    trocar_scene *scene;
    bool end_on;             /* whether the probe's end, rather than its side, is pressed on the tissue */
    trocar_pose home;        /* of the probe, clear of the surface; its local x axis, or z if `end_on`, points into the tissue */
    double pivot;            /* m, from the probe's base to the point it is tilted about */
    trocar_pose needle;      /* of the needle before the insertion */
    double advance;          /* m, length of the insertion */
    needle_use use;
    hand_motion motion;      /* of the probe */
} probe_scene;

/* Places the probe on a block of tissue, beside the needle's entry point if there is a needle, otherwise anywhere. */
static void place_on_block(probe_scene *s, uint64_t *seed, double radius, double length) {
    const double *entry = s->block->entry, upright[3] = {0, 0, 1};
    double away = radius + random_between(seed, 3e-3, 10e-3), angle = random_between(seed, -M_PI, M_PI), dir[3];
    trocar_pose *home = &s->home;
    *home = (trocar_pose){.orientation = {1, 0, 0, 0}};
    if (s->use == WITHOUT) away = random_between(seed, 0, 15e-3);
    if (s->end_on) {
        quaternion_turn(home->orientation, random_between(seed, -0.15, 0.15), random_between(seed, -0.15, 0.15), 0);
        quaternion_rotate(home->orientation, upright, dir);
        double lowest = -CLEARANCE - radius * hypot(dir[0], dir[1]); /* low enough that the tilted probe's rim does not touch the surface */
        const double tip[3] = {entry[0] + away * cos(angle), entry[1] + away * sin(angle), lowest};
        for (int a = 0; a < 3; a++) home->position[a] = tip[a] - length * dir[a];
        s->pivot = length;
    } else {
        quaternion_turn(home->orientation, 0, 0, angle);
        quaternion_turn(home->orientation, 0, -0.5 * M_PI, 0);
        quaternion_rotate(home->orientation, upright, dir);
        double beyond = random_between(seed, -10e-3, 30e-3);
        home->position[0] = entry[0] - away * sin(angle) + (beyond - length) * dir[0];
        home->position[1] = entry[1] + away * cos(angle) + (beyond - length) * dir[1];
        home->position[2] = -CLEARANCE - radius;
        s->pivot = length - 0.03;
    }
    s->needle = (trocar_pose){{entry[0], entry[1], -s->block->length - 2e-3}, {1, 0, 0, 0}};
    s->advance = 2e-3 + random_between(seed, 0.01, 0.05);
}

/* Places the probe in the rectum of meshes/trus.yaml, whose wall is 10 mm from its axis, and the needle in a hole of the scene's template. */
static void place_in_rectum(probe_scene *s, uint64_t *seed) {
    s->home = (trocar_pose){{0, -0.032, -0.08}, {sqrt(0.5), 0, 0, sqrt(0.5)}};
    s->pivot = 0.11;
    double column = floor(random_between(seed, -3, 4)), row = floor(random_between(seed, -2, 3));
    s->needle = (trocar_pose){{5e-3 * column, 5e-3 * row, -0.23}, {1, 0, 0, 0}};
    s->advance = 0.03 + random_between(seed, 0.04, 0.075);
}

static void add_leg(probe_scene *s, uint64_t *seed, double press, const double slide[2], const double tilt[2], double roll) {
    hand_leg leg = {.tilt = {tilt[0], tilt[1]}, .roll = roll};
    leg.aside[0] = (s->end_on ? slide[0] : press) - s->pivot * sin(tilt[1]);
    leg.aside[1] = slide[1] + s->pivot * sin(tilt[0]);
    leg.advance = s->end_on ? press : slide[0];
    hand_add(&s->motion, random_between(seed, SLOWEST, FASTEST), leg);
}

/* Presses the probe on the tissue, moves it about, and lifts it. */
static void create_motion(probe_scene *s, uint64_t *seed) {
    const double none[2] = {0, 0};
    double deepest = s->block ? 9e-3 : 12e-3, depth = random_between(seed, 2e-3, deepest), lean = s->end_on ? 0.1 : 0.04;
    add_leg(s, seed, CLEARANCE + depth, none, none, 0);
    int moves = (int)random_between(seed, 1, 4);
    for (int i = 0; i < moves; i++) {
        double press = random_chance(seed, 0.6) ? random_between(seed, 0.5e-3, deepest) - depth : 0.0;
        double roll = random_chance(seed, 0.3) ? random_between(seed, -1.5, 1.5) : 0.0;
        double slide[2] = {0, 0}, tilt[2] = {0, 0};
        if (random_chance(seed, 0.5)) {
            slide[0] = s->block ? random_between(seed, -8e-3, 8e-3) : random_between(seed, -15e-3, 3e-3);
            slide[1] = random_between(seed, -4e-3, 4e-3);
        }
        if (random_chance(seed, 0.5)) tilt[0] = random_between(seed, -lean, lean), tilt[1] = random_between(seed, -lean, lean);
        depth += press;
        add_leg(s, seed, press, slide, tilt, roll);
    }
    add_leg(s, seed, -depth - CLEARANCE, none, none, 0);
}

static void probe_scene_create(probe_scene *s, int number) {
    trocar_error why;
    uint64_t seed = 0xA24BAED4963EE407u * (unsigned)(number + 3);
    char key[80];
    *s = (probe_scene){0};
    for (int i = 0; i < 4; i++) random_between(&seed, 0, 1);
    double kind = random_between(&seed, 0, 1);
    bool on_block = random_chance(&seed, 0.7);
    s->use = kind < 0.4 ? WITHOUT : kind < 0.7 ? HELD : RESTING;
    if (on_block) s->block = random_scene_create(1000u + (unsigned)number), s->scene = s->block->scene;
    else fail_if(trocar_scene_load(MESHES "/trus.yaml", &s->scene, &why), &why);
    for (int i = 0; i < trocar_scene_count(s->scene, "regions"); i++) {
        snprintf(key, sizeof key, "regions[%d].youngs_modulus", i);
        scene_number(s->scene, key, random_factor(&seed, 3e3, 100e3));
    }
    double radius = s->block ? random_between(&seed, 6e-3, 15e-3) : random_between(&seed, 6e-3, 9e-3), length = 0.15;
    s->end_on = s->block && random_chance(&seed, 0.4);
    scene_number(s->scene, "needles", 2);
    scene_text(s->scene, "probe.surface", s->block ? "skin" : "rectum_wall");
    scene_number(s->scene, "probe.radius", radius);
    scene_number(s->scene, "probe.tip_radius", radius * random_between(&seed, 0.2, 1));
    scene_number(s->scene, "probe.length", length);
    scene_number(s->scene, "probe.max_force", random_factor(&seed, 5, 40));
    if (s->block) place_on_block(s, &seed, radius, length);
    else place_in_rectum(s, &seed);
    create_motion(s, &seed);
}

static void probe_scene_free(probe_scene *s) {
    if (s->block) random_scene_free(s->block);
    else trocar_scene_free(s->scene);
}

/* ---- runs ---------------------------------------------------------------------------------------------------------------------- */

static void list_triangles(trial *t) {
    static const int faces[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};
    const uint32_t *surfaces = trocar_model_face_surfaces(t->model);
    const int32_t *tets = trocar_model_tets(t->model);
    int count = 4 * trocar_model_tet_count(t->model);
    t->triangles = malloc((size_t)count * sizeof *t->triangles);
    for (int i = 0; i < count; i++)
        if (surfaces[i] >> t->shape.surface & 1) {
            for (int c = 0; c < 3; c++) t->triangles[t->triangle_count][c] = tets[i - i % 4 + faces[i % 4][c]];
            t->triangle_count++;
        }
}

static void open_trial(trial *t, const probe_scene *s) {
    trocar_error why;
    fail_if(trocar_model_create(s->scene, NULL, &t->model, &why), &why);
    fail_if(trocar_sim_create(t->model, &t->sim, &why), &why);
    fail_if(trocar_scene_get_number(s->scene, "probe.max_force", &t->max_force, &why), &why);
    trocar_model_probe(t->model, &t->shape);
    t->displacements = calloc(3 * (size_t)trocar_model_node_count(t->model), sizeof *t->displacements);
    list_triangles(t);
    for (int n = 0; n < 2; n++) {
        trocar_pose aside = {{0.1, 0.1 + 0.1 * n, -0.4}, {1, 0, 0, 0}};
        t->base[n] = n == 0 && s->use != WITHOUT ? s->needle : aside;
        fail_if(trocar_sim_reset(t->sim, n, &t->base[n], &why), &why);
    }
    set_probe(t, &s->home);
    t->probe.base = s->home;
}

static void close_trial(trial *t) {
    trocar_sim_free(t->sim);
    trocar_model_free(t->model);
    free(t->displacements);
    free(t->triangles);
}

/* Leaves the needle in the tissue where it is. From then on, another needle, far away, is ticked. If the needle cannot be left, it is still held. */
static void leave_needle(trial *t) {
    trocar_error why;
    if (trocar_sim_leave(t->sim, 0, &why) == TROCAR_OK && trocar_sim_work(t->sim, NULL, &why) == TROCAR_OK) t->needle = 1;
    else t->found.kept++;
}

static void withdraw_needle(trial *t, double advance) {
    trocar_error why;
    if (trocar_sim_needle_state(t->sim, 0) == TROCAR_NEEDLE_RESTING) {
        fail_if(trocar_sim_take(t->sim, 0, &why), &why);
        tick(t, &t->base[1]);
        t->needle = 0;
        t->base[0] = trocar_view_base(trocar_sim_view(t->sim), 0);
        t->last[0] = (trocar_output){0};
    }
    push_needle(t, -advance - 5e-3);
}

enum { TOLD_EVERY = 10 };

static void tell_run(const trial *t, double seconds) {
    static const char *const names[FINDINGS] = {"nodes inside, m", "faces unfelt, radii", "faces, radii", "jump", "jump after a stop", "needle's jump", "overload",
                                                "force of the most", "gain", "gain with a needle"};
    const findings *f = &t->found;
    printf("run %d:", t->number);
    for (int k = 0; k < FINDINGS; k++)
        if (isfinite(f->of[k].worst)) printf(" %s %.3g (%d);", names[k], f->of[k].worst, f->of[k].above);
    printf(" work %.3g of %.3g mJ, unlike %d, failed %d, kept %d, ticks %ld, looks %ld, pressed %ld, stopped %ld, %.1f s\n", 1e3 * t->work, 1e3 * t->most_work, f->unlike,
           f->failed, f->kept, f->ticks, f->looks, f->pressed, f->stopped, seconds);
    fflush(stdout);
}

static void run_trial(int number, bool talks, findings *sum) {
    trial t = {.number = number, .talks = talks};
    findings *f = &t.found;
    probe_scene s;
    clock_t begun = clock();
    findings_begin(f);
    probe_scene_create(&s, number);
    open_trial(&t, &s);
    if (talks)
        printf("run %d: %s, %s, %s, radius %.1f mm, tip %.1f mm, at most %.1f N\n", number, s.block ? "block" : "trus.yaml", s.end_on ? "end on" : "lying",
               (const char *[]){"no needle", "needle held", "needle resting"}[s.use], 1e3 * t.shape.radius, 1e3 * t.shape.tip_radius, t.max_force);
    tick(&t, &t.base[0]);
    if (s.use != WITHOUT) push_needle(&t, s.advance);
    if (s.use == RESTING) leave_needle(&t);
    tick(&t, &t.base[t.needle]);
    t.moving = true;
    for (int k = 0; k < s.motion.count; k++) follow(&t, &s.motion.legs[k]);
    go_home(&t, &s.home);
    t.moving = false;
    f->touching_at_last = s.use == WITHOUT && t.probe.contacts > 0; /* not counted with a needle, which may have moved the tissue to where the probe started */
    if (s.use != WITHOUT) withdraw_needle(&t, s.advance);
    exceeds(&t, s.use == WITHOUT ? GAIN : GAIN_WITH_NEEDLE, -t.work / fmax(t.most_work, 1e-6));
    f->runs = 1, f->uses[s.use]++, f->ticks = t.ticks;
    if (talks) tell_run(&t, (double)(clock() - begun) / CLOCKS_PER_SEC);
    findings_add(sum, f);
    if (sum->runs % TOLD_EVERY == 0)
        fprintf(stderr, "%d motions: %d jumps, %d of the needle's, %d unfelt, %d nodes inside\n", sum->runs, sum->of[JUMP].above + sum->of[JUMP_AFTER_STOP].above,
                sum->of[NEEDLE_JUMP].above, sum->of[UNFELT_DEPTH].above, sum->of[NODE_DEPTH].above);
    close_trial(&t);
    probe_scene_free(&s);
}

/* ---- rows ---------------------------------------------------------------------------------------------------------------------- */

static void add(rows *r, const findings *f, finding_kind kind, const char *check, const char *reference, const char *unit, const char *what) {
    const finding *of = &f->of[kind];
    char note[300];
    snprintf(note, sizeof note, "%s%s%d above; run %d", what, what[0] ? "; " : "", of->above, of->run);
    rows_add(r, (row){.check = check, .reference = reference, .value = of->worst, .expected = NAN, .error = fmax(0.0, of->worst), .limit = LIMITS[kind], .unit = unit,
                      .note = note});
}

static void add_measured(rows *r, const findings *f, finding_kind kind, const char *check, const char *unit) {
    char note[40];
    snprintf(note, sizeof note, "run %d", f->of[kind].run);
    rows_measured(r, (row){.check = check, .value = f->of[kind].worst, .expected = NAN, .error = f->of[kind].worst, .unit = unit, .note = note});
}

static void add_count(rows *r, const char *check, int count) {
    rows_add(r, (row){.check = check, .reference = "none", .value = count, .expected = 0, .error = count, .limit = 0});
}

static void report(rows *r, const findings *f) {
    char note[200];
    snprintf(note, sizeof note, "%d motions, %ld looks", f->runs, f->looks);
    add(r, f, NODE_DEPTH, "probe motions: deepest node of the pressed surface inside the probe", "none", "m", note);
    add(r, f, UNFELT_DEPTH, "probe motions: deepest face inside a probe that bears no force", "a right angle's chord", "radii", "");
    add_measured(r, f, FACE_DEPTH, "probe motions: deepest face inside the probe, at any force", "radii");
    snprintf(note, sizeof note, "%ld ticks, pressed in %ld", f->ticks, f->pressed);
    add(r, f, JUMP, "probe motions: largest change of the probe's force between two solutions", "max(7 %, 0.05 N)", NULL, note);
    add(r, f, JUMP_AFTER_STOP, "probe motions: the same where the tissue had stopped the probe, and it may catch up with the hand", "max(7 %, 0.05 N)", NULL, "");
    snprintf(note, sizeof note, "%d motions beside a held needle", f->uses[HELD]);
    add(r, f, NEEDLE_JUMP, "probe motions: largest change of the needle's force in a tick", "max(7 %, 0.05 N)", NULL, note);
    snprintf(note, sizeof note, "of the largest work on the way; %d motions", f->uses[WITHOUT]);
    add(r, f, GAIN, "probe motions: energy gained over a closed path without a needle", "none", NULL, note);
    snprintf(note, sizeof note, "of the largest work on the way; %d motions", f->uses[HELD] + f->uses[RESTING]);
    add(r, f, GAIN_WITH_NEEDLE, "probe motions: energy gained over a closed path with a needle in the tissue", "none", NULL, note);
    snprintf(note, sizeof note, "stopped in %ld ticks", f->stopped);
    add(r, f, OVERLOAD, "probe motions: force beyond probe.max_force that a move raised it to", "stops there", NULL, note);
    add_measured(r, f, FORCE, "probe motions: largest force, also where a needle raised it", "of probe.max_force");
    add_count(r, "probe motions: ticks with the probe away from its pose without a word, or where it should be but said to be stopped", f->unlike);
    add_count(r, "probe motions: ticks that were unstable or not finite", f->failed);
    add_count(r, "probe motions: probes without a needle that are pressed where they began", f->touching_at_last);
}

int main(int argc, char **argv) {
    findings f;
    findings_begin(&f);
    if (argc == 4 && strcmp(argv[1], "--runs") == 0) {
        for (int i = atoi(argv[2]); i <= atoi(argv[3]); i++) run_trial(i, true, &f);
        return 0;
    }
    rows r = rows_begin(argc, argv, "Coupled: probe motions");
    static const int SHORT[] = {5, 71, 137, 150}; /* these runs pass; together they cover both scenes (block and rectum), the probe's side and end, a stop at
                                                     the force limit, and everything that a needle does beside the probe */
    int runs = r.short_form ? (int)(sizeof SHORT / sizeof *SHORT) : 200;
    for (int i = 0; i < runs; i++) run_trial(r.short_form ? SHORT[i] : i, !r.short_form, &f);
    report(&r, &f);
    return rows_end(&r);
}
