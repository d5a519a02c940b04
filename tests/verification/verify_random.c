/* Checks random motions of a slow hand in random scenes with all features enabled. Forces must be continuous except at punctures, a hand that returns to
   where it started must not have gained energy, and no needle's end may be in the tissue without a contact. */
#include "random_scene.h"
#include "rows.h"

static const double TICK = 1e-3, SPEED = 8e-3;       /* s, m/s */
static const double NOTICED = 0.07, NOTICED_LEAST = 0.05; /* just noticeable difference in force: as a fraction, and in N */
enum { RECOIL = 30, LOOK_EVERY = 50 };               /* ticks */

typedef struct {
    int runs, jumps, spikes, unstable, lost, kept;
    long ticks;
    double worst_jump, worst_spike; /* largest jump and spike of the force, in just noticeable differences */
    double least_work;       /* work of the hand over a closed path, as a fraction of the largest work along it */
    int jump_run, spike_run, work_run;
    int beyond;              /* jumps and spikes after the tip has slid over an edge of the block */
    double worst_within;     /* largest jump or spike among the others */
    int within_run;
    int unexplained;         /* lost needles that are deeper than the other needles' dents, computed in closed form */
    double deepest;          /* m, largest depth of such a needle below those dents */
    bool talks;
} findings;

typedef struct {
    random_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    double radius;           /* m, of the needles */
    double *displacements;
    trocar_pose base[3];
    trocar_output last[3];
    double history[3][3];    /* N, forces of the last three ticks */
    bool over_edge;          /* the tip has slid over an edge of the block and has not been clear of the block since */
    int since;               /* ticks since the last puncture, exit, or change in which needles rest */
    double work, most_work;
    long ticks;
    bool unstable;
    int jumps, spikes, lost;
    double worst_jump, worst_spike;
    findings *found;
    int number;
} trial;

/* Returns whether a point is in the displaced tissue. */
static bool in_tissue(const trial *t, const double x[3]) {
    const double *nodes = trocar_model_nodes(t->model);
    const int32_t *tets = trocar_model_tets(t->model);
    for (int e = 0; e < trocar_model_tet_count(t->model); e++) {
        double p[4][3], sum = 0.0;
        bool inside = true;
        for (int k = 0; k < 4; k++)
            for (int a = 0; a < 3; a++) p[k][a] = nodes[3 * tets[4 * e + k] + a] + t->displacements[3 * tets[4 * e + k] + a] - x[a];
        for (int k = 0; k < 4 && inside; k++) { /* signs of the volumes that result if the point replaces one corner */
            const double *q[3];
            for (int i = 0, n = 0; i < 4; i++)
                if (i != k) q[n++] = p[i];
            double v = q[0][0] * (q[1][1] * q[2][2] - q[1][2] * q[2][1]) + q[0][1] * (q[1][2] * q[2][0] - q[1][0] * q[2][2]) + q[0][2] * (q[1][0] * q[2][1] - q[1][1] * q[2][0]);
            v *= k % 2 ? 1.0 : -1.0;
            if (k == 0) sum = v;
            inside = sum == 0.0 || v * sum >= 0.0;
        }
        if (inside) return true;
    }
    return false;
}

/* Returns how far (m) the other needles push the skin along the axis at this needle's entry point. Uses the closed-form displacement of a half-space,
   including the part that the mesh represents. A tip on the skin acts as a flat punch, which fixes the surface whatever loads the tissue remembers (Sneddon
   1965). The forces of a tip inside the tissue are applied at the skin (Boussinesq), which gives an upper bound. */
static double dent_by_others(const trial *t, int needle, const double end[3], const double axis[3], double radius) {
    trocar_contact contacts[TROCAR_MAX_POINTS];
    trocar_material m = trocar_model_material(t->model, trocar_model_tet_regions(t->model)[0]);
    double sum = 0.0, entry[3], at[3], far[3];
    for (int a = 0; a < 3; a++) far[a] = end[a] - 0.05 * axis[a];
    if (!trocar_model_entry(t->model, far, end, entry)) return 0.0;
    for (int n = 0; n < trocar_model_needles(t->model); n++) {
        int count = n == needle ? 0 : trocar_view_contacts(trocar_sim_view(t->sim), n, contacts, TROCAR_MAX_POINTS);
        for (int i = 0; i < count; i++) {
            const trocar_contact *c = &contacts[i];
            bool on_skin = c->kind == TROCAR_CONTACT_TIP && c->depth <= 0.0;
            double r = fmax(radius, distance3(entry, c->position));
            if (c->kind == TROCAR_CONTACT_GUIDE) continue;
            if (on_skin && trocar_model_entry(t->model, trocar_view_base(trocar_sim_view(t->sim), n).position, c->position, at))
                sum += 2 / M_PI * distance3(at, c->position) * asin(radius / fmax(radius, distance3(entry, at)));
            for (int a = 0; a < 3 && !on_skin; a++) sum += (1 - pow(m.poisson_ratio, 2)) / (M_PI * m.youngs_modulus * r) * c->force[a] * axis[a];
        }
    }
    return sum;
}

/* Compares the depth of the needle's end in the displaced mesh with the other needles' dents (dent_by_others). */
static void explain(trial *t, int needle, const double end[3], const double axis[3]) {
    static const double FINE = 0.1e-3; /* m */
    double deep = 1e-3, x[3];
    do {
        deep += FINE;
        for (int a = 0; a < 3; a++) x[a] = end[a] - deep * axis[a];
    } while (deep < 0.05 && in_tissue(t, x));
    double dent = dent_by_others(t, needle, end, axis, t->radius);
    if (deep > dent) t->found->unexplained++;
    t->found->deepest = fmax(t->found->deepest, deep - dent);
    if (t->found->talks) printf("run %d, %.3f s: needle %d unfelt %.2f mm deep, others dent the skin by %.2f mm\n", t->number, t->ticks * TICK, needle, 1e3 * deep, 1e3 * dent);
}

/* Returns whether the needle's end is a millimetre or more deep in the tissue and has no contact. */
static bool passes_unfelt(trial *t, int needle) {
    trocar_contact contacts[TROCAR_MAX_POINTS];
    double line[TROCAR_MAX_JOINTS][3], behind[3], length;
    trocar_error why;
    int count = trocar_view_contacts(trocar_sim_view(t->sim), needle, contacts, TROCAR_MAX_POINTS), joints;
    for (int i = 0; i < count; i++)
        if (contacts[i].kind != TROCAR_CONTACT_GUIDE) return false;
    joints = trocar_view_centreline(trocar_sim_view(t->sim), needle, line[0], TROCAR_MAX_JOINTS);
    const double *end = line[joints - 1], *before = line[joints - 2];
    for (int a = 0; a < 3; a++) behind[a] = end[a] - before[a];
    length = length3(behind);
    for (int a = 0; a < 3; a++) behind[a] = end[a] - 1e-3 * behind[a] / length;
    fail_if(trocar_view_displacements(trocar_sim_view(t->sim), t->displacements, &why), &why);
    if (!in_tissue(t, end) || !in_tissue(t, behind)) return false;
    for (int a = 0; a < 3; a++) behind[a] = (end[a] - before[a]) / length;
    explain(t, needle, end, behind);
    return true;
}

/* Tracks whether the tip has slid over an edge of the block's skin. If it has, the needle springs into the space beside the block and meets the block from
   the side, where the model carries no force, or from below. */
static void note_edge(trial *t) {
    double line[TROCAR_MAX_JOINTS][3];
    trocar_contact contacts[TROCAR_MAX_POINTS];
    const trocar_view *view = trocar_sim_view(t->sim);
    const double *end = line[trocar_view_centreline(view, 0, line[0], TROCAR_MAX_JOINTS) - 1];
    int count = trocar_view_contacts(view, 0, contacts, TROCAR_MAX_POINTS);
    if (count > 0 && contacts[count - 1].kind == TROCAR_CONTACT_TIP && fmax(fabs(end[0]), fabs(end[1])) > 0.5 * BLOCK_WIDTH) t->over_edge = true;
    if (end[2] < 0.0 && (count == 0 || contacts[count - 1].kind == TROCAR_CONTACT_GUIDE)) t->over_edge = false;
}

static void judge(trial *t, const trocar_output *out) {
    double change = 0.0, bend = 0.0;
    memmove(t->history[0], t->history[1], 2 * sizeof t->history[0]);
    memcpy(t->history[2], out->force, sizeof t->history[2]);
    if (++t->since < 3) return;
    for (int a = 0; a < 3; a++) {
        change += pow(t->history[2][a] - t->history[1][a], 2);
        bend += pow(t->history[1][a] - 0.5 * (t->history[0][a] + t->history[2][a]), 2);
    }
    double noticed = fmax(NOTICED_LEAST, NOTICED * length3(t->history[1])), jump = sqrt(change) / noticed, spike = 2.0 * sqrt(bend) / noticed;
    if (t->since < RECOIL) return;
    t->jumps += jump > 1.0, t->spikes += spike > 1.0;
    note_edge(t);
    if (t->over_edge) t->found->beyond += (jump > 1.0) + (spike > 1.0);
    else if (fmax(jump, spike) > t->found->worst_within) t->found->worst_within = fmax(jump, spike), t->found->within_run = t->number;
    if (t->found->talks && (jump > 1.0 || spike > 1.0) && t->jumps + t->spikes < 40)
        printf("run %d, %.3f s: jump %.2f, spike %.2f, %.3f %.3f %.3f N, depth %.2f mm, events %#x%s\n", t->number, t->ticks * TICK, jump, spike, length3(t->history[0]),
               length3(t->history[1]), length3(t->history[2]), 1e3 * out->depth, out->events, t->over_edge ? ", over the edge" : "");
    t->worst_jump = fmax(t->worst_jump, jump);
    t->worst_spike = fmax(t->worst_spike, spike);
}

static void tick(trial *t, int needle, const trocar_pose *base) {
    trocar_output out;
    trocar_error why;
    fail_if(trocar_sim_step(t->sim, needle, base, TICK, &out, &why), &why);
    t->work += hand_work(&t->base[needle], t->last[needle].force, t->last[needle].torque, base, out.force, out.torque);
    t->most_work = fmax(t->most_work, t->work);
    t->base[needle] = *base;
    t->last[needle] = out;
    t->ticks++;
    if (out.events & (TROCAR_EVENT_PUNCTURED | TROCAR_EVENT_EXITED)) t->since = 0;
    if (out.events & TROCAR_EVENT_UNSTABLE && t->found->talks && !t->unstable) printf("run %d, %.3f s: unstable at %.2f mm after %.3f N\n", t->number, t->ticks * TICK, 1e3 * out.depth, length3(t->history[2]));
    t->unstable = t->unstable || out.events & TROCAR_EVENT_UNSTABLE;
    if (t->ticks % LOOK_EVERY == 0) t->lost += passes_unfelt(t, needle);
    if (needle == 0) judge(t, &out);
}

static void place(trial *t, int needle, const trocar_pose *base) {
    trocar_error why;
    fail_if(trocar_sim_reset(t->sim, needle, base, &why), &why);
    t->base[needle] = *base;
    t->last[needle] = (trocar_output){0};
}

static void follow(trial *t, int needle, const hand_leg *leg) {
    trocar_pose from = t->base[needle];
    int ticks = (int)ceil(leg->seconds / TICK);
    for (int i = 1; i <= ticks; i++) {
        trocar_pose p = hand_pose(leg, &from, i * TICK);
        tick(t, needle, &p);
    }
}

/* Moves straight to a pose that is not part of a leg. */
static void go_to(trial *t, int needle, const trocar_pose *to, double seconds) {
    trocar_pose from = t->base[needle];
    int ticks = (int)ceil(seconds / TICK);
    for (int i = 1; i <= ticks; i++) {
        trocar_pose p = pose_towards(&from, to, (double)i / ticks);
        tick(t, needle, &p);
    }
}

/* Inserts a needle beside the moving needle's entry point, and leaves it. */
static void leave_beside(trial *t, int needle, uint64_t *seed) {
    trocar_error why;
    double angle = random_between(seed, 0, 2 * M_PI), away = random_between(seed, 4e-3, 12e-3);
    trocar_pose start = {{t->scene->entry[0] + away * cos(angle), t->scene->entry[1] + away * sin(angle), -t->scene->length - 2e-3}, {1, 0, 0, 0}};
    place(t, needle, &start);
    hand_motion m = {0};
    hand_add(&m, 0.05, (hand_leg){.advance = random_between(seed, 0.02, 0.05)});
    follow(t, needle, &m.legs[0]);
    if (trocar_sim_leave(t->sim, needle, &why) != TROCAR_OK) return;
    if (trocar_sim_work(t->sim, NULL, &why) != TROCAR_OK) { /* on failure, the needle is still held */
        t->found->kept++;
        if (t->found->talks) printf("run %d: %s\n", t->number, why.text);
    }
    tick(t, 0, &t->base[0]);
}

static void take_and_draw(trial *t, int needle) {
    trocar_error why;
    if (trocar_sim_needle_state(t->sim, needle) == TROCAR_NEEDLE_RESTING) {
        fail_if(trocar_sim_take(t->sim, needle, &why), &why);
        t->base[needle] = trocar_view_base(trocar_sim_view(t->sim), needle);
        tick(t, 0, &t->base[0]);
        t->base[needle] = trocar_view_base(trocar_sim_view(t->sim), needle);
        t->last[needle] = (trocar_output){0};
    }
    hand_motion m = {0};
    hand_add(&m, 0.05, (hand_leg){.advance = -0.07});
    follow(t, needle, &m.legs[0]);
}

static void run_trial(int number, double speed, findings *f) {
    trial t = {.scene = random_scene_create((uint64_t)number), .found = f, .number = number};
    trocar_error why;
    uint64_t seed = 77u + (uint64_t)number;
    for (int i = 0; i < 4; i++) random_between(&seed, 0, 1);
    fail_if(trocar_model_create(t.scene->scene, NULL, &t.model, &why), &why);
    fail_if(trocar_sim_create(t.model, &t.sim, &why), &why);
    t.displacements = calloc(3 * (size_t)trocar_model_node_count(t.model), sizeof *t.displacements);
    fail_if(trocar_scene_get_number(t.scene->scene, "needle.outer_diameter", &t.radius, &why), &why);
    t.radius *= 0.5;
    hand_motion m = random_motion(t.scene, (uint64_t)number, speed);
    place(&t, 0, &m.start);
    for (int i = 1; i < t.scene->needles; i++) {
        trocar_pose aside = {{0.1 * i, 0.1, -0.3}, {1, 0, 0, 0}};
        place(&t, i, &aside);
    }
    for (int i = 1; i < t.scene->needles; i++) leave_beside(&t, i, &seed);
    t.since = 0;
    for (int k = 0; k < m.count; k++) follow(&t, 0, &m.legs[k]);
    go_to(&t, 0, &m.start, 0.2);
    for (int i = 1; i < t.scene->needles; i++) take_and_draw(&t, i);
    f->runs++;
    f->ticks += t.ticks;
    f->jumps += t.jumps, f->spikes += t.spikes, f->lost += t.lost, f->unstable += t.unstable;
    if (t.worst_jump > f->worst_jump) f->worst_jump = t.worst_jump, f->jump_run = number;
    if (t.worst_spike > f->worst_spike) f->worst_spike = t.worst_spike, f->spike_run = number;
    double part = t.most_work > 0.0 ? t.work / fmax(t.most_work, 1e-6) : 0.0;
    if (part < f->least_work) f->least_work = part, f->work_run = number;
    if (f->talks)
        printf("run %d: %ld ticks, worst jump %.2f, spike %.2f, work %.3g of %.3g mJ%s%s\n", number, t.ticks, t.worst_jump, t.worst_spike, 1e3 * t.work, 1e3 * t.most_work,
               t.unstable ? ", unstable" : "", t.lost ? ", unfelt" : ""), fflush(stdout);
    trocar_sim_free(t.sim);
    trocar_model_free(t.model);
    free(t.displacements);
    random_scene_free(t.scene);
}

/* ---- implants ----------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int implants, needles, lost, kept, unexplained;
    double deepest;
    bool talks;
} implant_findings;

enum { COLUMNS = 7, ROWS = 5, ACROSS = -3, UP = -2 }; /* holes around the template's centre; ACROSS, UP: first column and row */
static const double PITCH = 5e-3;                     /* m */

/* Inserts as many needles as the scene allows, one after another, through random holes of the implant scene's template, in surroundings of 3 to 30 kPa and
   at the speed of a hand. Each needle is left at its depth, so those inserted later find the tissue displaced. */
static void run_implant(int number, implant_findings *f) {
    trial t = {.found = &(findings){0}, .number = number};
    trocar_error why;
    trocar_scene *scene;
    uint64_t seed = 4099u + (uint64_t)number;
    bool taken[COLUMNS * ROWS] = {false};
    for (int i = 0; i < 4; i++) random_between(&seed, 0, 1);
    fail_if(trocar_scene_load(MESHES "/implant.yaml", &scene, &why), &why);
    fail_if(trocar_scene_set_number(scene, "regions[surrounding].youngs_modulus", random_factor(&seed, 3e3, 30e3), &why), &why);
    fail_if(trocar_model_create(scene, NULL, &t.model, &why), &why);
    fail_if(trocar_sim_create(t.model, &t.sim, &why), &why);
    t.displacements = calloc(3 * (size_t)trocar_model_node_count(t.model), sizeof *t.displacements);
    fail_if(trocar_scene_get_number(scene, "needle.outer_diameter", &t.radius, &why), &why);
    t.radius *= 0.5;
    for (int n = 0; n < trocar_model_needles(t.model); n++) {
        int hole;
        do hole = (int)random_between(&seed, 0, COLUMNS * ROWS);
        while (taken[hole]);
        taken[hole] = true;
        trocar_pose base = {{PITCH * (ACROSS + hole % COLUMNS), PITCH * (UP + hole / COLUMNS), -0.23}, {1, 0, 0, 0}};
        double way = 0.03 + random_between(&seed, 0.05, 0.08), speed = random_between(&seed, 0.03, 0.12);
        int ticks = (int)ceil(way / (speed * TICK)), lost = 0;
        trocar_output out;
        fail_if(trocar_sim_reset(t.sim, n, &base, &why), &why);
        for (int i = 1; i <= ticks + LOOK_EVERY; i++) { /* after the motion, the needle is held at rest until it has been checked once */
            if (i <= ticks) base.position[2] += way / ticks;
            fail_if(trocar_sim_step(t.sim, n, &base, TICK, &out, &why), &why);
            if (i % LOOK_EVERY == 0) lost += passes_unfelt(&t, n);
        }
        f->needles++, f->lost += lost;
        if (f->talks && lost) printf("implant %d, needle %d: unfelt in %d looks, at last %.1f mm deep, %.2f N\n", number, n, lost, 1e3 * out.depth, length3(out.force));
        if (trocar_sim_leave(t.sim, n, &why) != TROCAR_OK || trocar_sim_work(t.sim, NULL, &why) != TROCAR_OK) {
            f->kept++;
            if (f->talks) printf("implant %d, needle %d, %.1f mm deep, %.2f N: %s\n", number, n, 1e3 * out.depth, length3(out.force), why.text);
        }
    }
    f->implants++;
    f->unexplained += t.found->unexplained;
    f->deepest = fmax(f->deepest, t.found->deepest);
    trocar_sim_free(t.sim);
    trocar_model_free(t.model);
    trocar_scene_free(scene);
    free(t.displacements);
}

/* Adds to a note in how many checks the other needles' dents were not deep enough to explain why a needle in the tissue has no contact. */
static void append_unexplained(char *note, size_t size, int unexplained, double deepest) {
    size_t at = strlen(note);
    if (unexplained > 0) snprintf(note + at, size - at, "%s%d deeper than the other needles' dents in closed form, by up to %.1f mm", at > 0 ? "; " : "", unexplained, 1e3 * deepest);
}

static void report_implants(rows *r, const implant_findings *f) {
    char note[300];
    snprintf(note, sizeof note, "%d implants, %d needles; %d could not be left, and were held", f->implants, f->needles, f->kept);
    append_unexplained(note, sizeof note, f->unexplained, f->deepest);
    rows_add(r, (row){.check = "implants in soft tissue: looks at a needle in the tissue that nothing touches", .reference = "none", .value = f->lost, .expected = 0, .error = f->lost, .limit = 0, .note = note});
}

/* ---- rows --------------------------------------------------------------------------------------------------------------------- */

static void report(rows *r, const findings *f) {
    char note[300];
    snprintf(note, sizeof note, "%d runs, %ld ticks; %d above; run %d", f->runs, f->ticks, f->jumps, f->jump_run);
    rows_add(r, (row){.check = "random scenes: largest change of the force in a tick", .reference = "max(7 %, 0.05 N)", .value = f->worst_jump, .expected = NAN, .error = f->worst_jump, .limit = 1.0, .note = note});
    snprintf(note, sizeof note, "twice the distance of a tick's force from the mean of its neighbours'; %d above; run %d; %d of both after the tip had slid over the block's edge, largest of the others %.2f, run %d",
             f->spikes, f->spike_run, f->beyond, f->worst_within, f->within_run);
    rows_add(r, (row){.check = "random scenes: largest spike of the force", .reference = "max(7 %, 0.05 N)", .value = f->worst_spike, .expected = NAN, .error = f->worst_spike, .limit = 1.0, .note = note});
    snprintf(note, sizeof note, "of the largest work on the way; run %d", f->work_run);
    rows_add(r, (row){.check = "random scenes: least work of a hand over a closed path", .reference = "not negative", .value = f->least_work, .expected = NAN, .error = fmax(0.0, -f->least_work), .limit = 1e-3, .note = note});
    rows_add(r, (row){.check = "random scenes: motions in which no equilibrium was found", .reference = "none", .value = f->unstable, .expected = 0, .error = f->unstable, .limit = 0});
    note[0] = '\0';
    append_unexplained(note, sizeof note, f->unexplained, f->deepest);
    rows_add(r, (row){.check = "random scenes: looks at a needle in the tissue that nothing touches", .reference = "none", .value = f->lost, .expected = 0, .error = f->lost, .limit = 0, .note = note});
    rows_measured(r, (row){.check = "random scenes: needles that found no rest when they were left", .reference = "held as before", .value = f->kept, .expected = NAN, .error = f->kept});
}

/* Reports two runs of the full form. In run 47, a thin needle bows by 20 mm and snaps to another shape: steps that find no equilibrium are undone. In run
   270, a needle enters 3 kPa tissue where another one's tip has just entered. */
static void report_chosen_runs(rows *r) {
    findings snaps = {.talks = false}, enters = {.talks = false};
    run_trial(47, SPEED, &snaps);
    rows_add(r, (row){.check = "random scenes: largest change of the force while a needle snaps", .reference = "max(7 %, 0.05 N)", .value = snaps.worst_jump, .expected = NAN, .error = snaps.worst_jump, .limit = 1.0, .note = "run 47"});
    run_trial(270, SPEED, &enters);
    rows_add(r, (row){.check = "random scenes: looks at a needle that enters above another's tip, and that nothing touches", .reference = "none", .value = enters.lost, .expected = 0, .error = enters.lost, .limit = 0, .note = "run 270"});
}

enum { RUNS = 500, IMPLANTS = 200, SHORT_RUNS = 6, SHORT_IMPLANTS = 1, TOLD_EVERY = 10 };

/* Writes intermediate results, so that some exist if the run is killed early. */
static void tell_progress(const findings *f, const implant_findings *implants) {
    if ((f->runs + implants->implants) % TOLD_EVERY > 0) return;
    fprintf(stderr, "%d runs: jumps %d (%.2f, run %d), spikes %d (%.2f, run %d), work %.3g (run %d), unstable %d, unfelt %d (%d unexplained), not at rest %d; %d implants: unfelt %d, not at rest %d\n",
            f->runs, f->jumps, f->worst_jump, f->jump_run, f->spikes, f->worst_spike, f->spike_run, f->least_work, f->work_run, f->unstable, f->lost, f->unexplained, f->kept,
            implants->implants, implants->lost, implants->kept);
    fflush(stderr);
}

/* Runs part `part` of `parts` (counted from 1) of the full form. Its rows go to random-PART-of-PARTS.json. */
static int check(int argc, char **argv, int part, int parts) {
    findings f = {.talks = parts > 1};
    implant_findings implants = {.talks = parts > 1};
    char name[60], section[60] = "Coupled: random scenes";
    if (parts > 1) {
        snprintf(name, sizeof name, "verify_random-%d-of-%d", part, parts);
        snprintf(section, sizeof section, "Coupled: random scenes, part %d of %d", part, parts);
        argv[0] = name;
    }
    rows r = rows_begin(argc, argv, section);
    for (int i = part - 1; i < (r.short_form ? SHORT_RUNS : RUNS); i += parts) run_trial(i, SPEED, &f), tell_progress(&f, &implants);
    report(&r, &f);
    if (r.short_form) report_chosen_runs(&r);
    for (int i = part - 1; i < (r.short_form ? SHORT_IMPLANTS : IMPLANTS); i += parts) run_implant(i, &implants), tell_progress(&f, &implants);
    report_implants(&r, &implants);
    return rows_end(&r);
}

/* `--runs FIRST LAST` runs only these and prints the findings; `--implants FIRST LAST` does the same for implants. `--part K N FOLDER` runs part K of the N
   parts of the full form, and also prints the findings. Parts may run in parallel. */
int main(int argc, char **argv) {
    findings f = {.talks = true};
    implant_findings implants = {.talks = true};
    if (argc == 4 && strcmp(argv[1], "--implants") == 0) {
        for (int i = atoi(argv[2]); i <= atoi(argv[3]); i++) run_implant(i, &implants), fflush(stdout);
        printf("%d implants, %d needles: unfelt %d, not at rest %d\n", implants.implants, implants.needles, implants.lost, implants.kept);
        return 0;
    }
    if (argc >= 4 && strcmp(argv[1], "--runs") == 0) {
        for (int i = atoi(argv[2]); i <= atoi(argv[3]); i++) run_trial(i, argc > 4 ? atof(argv[4]) : SPEED, &f);
        printf("%d runs: jumps %d (%.2f, run %d), spikes %d (%.2f, run %d), work %.3g (run %d), unstable %d, unfelt %d (%d unexplained), not at rest %d\n", f.runs, f.jumps, f.worst_jump, f.jump_run, f.spikes,
               f.worst_spike, f.spike_run, f.least_work, f.work_run, f.unstable, f.lost, f.unexplained, f.kept);
        return 0;
    }
    if (argc == 5 && strcmp(argv[1], "--part") == 0) {
        int part = atoi(argv[2]), parts = atoi(argv[3]);
        if (part >= 1 && part <= parts) return check(2, (char *[]){argv[0], argv[4], NULL}, part, parts);
    }
    return check(argc, argv, 1, 1);
}
