/* Runs the figure-8 motion and a sideways push at depth on prostate meshes of many sizes. Compares the peak forces and, at each puncture, the force and the
   base travel since first touch. The reference is the finest of these meshes, so errors common to all of them do not show here; verify_resolution.py
   compares with a needle whose surface is resolved. */
#include <unistd.h>

#include "lockstep.h"
#include "rows.h"
#include "shared/motion.h"

static const char AFTER_PUNCTURE[] = "the peak occurs up to 20 ms after the capsule's puncture, while the needle springs forward; a coarse "
                                     "mesh then moves too little tissue around the tip";
static const double LIMIT = 0.07; /* relative just noticeable difference in force (Pang, Tan and Durlach 1991) */

typedef struct {
    int nodes, punctures;
    double push, pull, sagittal, torque;   /* peak values in the figure-8 motion, N; torque: N m */
    double way[4], force[4];               /* at each puncture: base travel since first touch (m) and axial force (N) */
    double sideways;                       /* N, largest force in the sideways push */
} outcome;

static void figure8(lockstep *l, outcome *o) {
    const motion *script = motion_find("figure8");
    for (int i = 1; i <= 2400; i++) {
        lockstep_tick(l, motion_pose(script, lockstep_start(), i * 1e-3), 1e-3);
        if (l->wrench.events & EVENT_PUNCTURED) {
            o->way[o->punctures & 3] = l->base.position.z + l->parts.needle.given.length;
            o->force[o->punctures++ & 3] = -l->wrench.force.z;
        }
        o->push = fmax(o->push, -l->wrench.force.z);
        o->pull = fmax(o->pull, l->wrench.force.z);
        o->sagittal = fmax(o->sagittal, -l->wrench.force.y);
        o->torque = fmax(o->torque, l->wrench.torque.x);
    }
}

static outcome run(const char *mesh) {
    simulation_config c = lockstep_config();
    snprintf(c.mesh_path, sizeof c.mesh_path, "%s", mesh);
    outcome o = {0};
    lockstep *l = lockstep_create(&c, lockstep_start());
    o.nodes = l->parts.mesh.node_count;
    figure8(l, &o);
    insertion_reset(&l->parts.insertion, lockstep_start(), &l->state);
    l->base = lockstep_start();
    lockstep_move(l, v3(0, 0, 0.066), 2.0, 1e-3);
    lockstep_move(l, v3(0.005, 0, 0), 0.5, 1e-3);
    o.sideways = -l->wrench.force.x;
    lockstep_free(l);
    return o;
}

static void compare(rows *r, const outcome *o, const outcome *finest) {
    char check[96], reference[64];
    snprintf(reference, sizeof reference, "own finest mesh, %d nodes", finest->nodes);
    const struct { const char *what, *unit; double value, expected; const char *note; } all[] = {
        {"push, axial peak", "N", o->push, finest->push, AFTER_PUNCTURE}, {"pull, axial peak", "N", o->pull, finest->pull, NULL},
        {"sagittal peak", "N", o->sagittal, finest->sagittal, NULL},      {"sagittal torque", "N m", o->torque, finest->torque, NULL},
        {"skin punctured at", "m", o->way[0], finest->way[0], NULL},      {"capsule punctured at", "m", o->way[1], finest->way[1], NULL},
        {"axial force at the capsule's puncture", "N", o->force[1], finest->force[1], NULL},
        {"sideways push at depth", "N", o->sideways, finest->sideways, NULL}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        double error = fabs(all[i].value - all[i].expected) / fabs(all[i].expected);
        snprintf(check, sizeof check, "%s, %d nodes", all[i].what, o->nodes);
        row entry = {.check = check, .reference = reference, .value = all[i].value, .expected = all[i].expected, .error = error,
                     .limit = LIMIT, .unit = all[i].unit, .note = all[i].note};
        if (all[i].note) rows_measured(r, entry);
        else rows_add(r, entry);
    }
}

static outcome run_or_fail(rows *r, const char *mesh) {
    if (access(mesh, R_OK) == 0) return run(mesh);
    const char *name = strrchr(mesh, '/') + 1;
    rows_add(r, (row){.check = name, .reference = "", .value = NAN, .expected = NAN, .error = NAN, .limit = LIMIT,
                      .note = "no such mesh: scripts/meshes makes it"});
    return (outcome){0};
}

int main(int argc, char **argv) {
    static const char *const files[] = {MESHES "/prostate-570.msh",      GENERATED "/prostate-1700.msh", GENERATED "/prostate-1750.msh",
                                        GENERATED "/prostate-1650.msh",  GENERATED "/prostate-3300.msh", GENERATED "/prostate-6500.msh",
                                        GENERATED "/prostate-20000.msh", GENERATED "/prostate-45000.msh"};
    rows r = rows_begin(argc, argv, "Mesh independence: figure 8 and a sideways push");
    outcome found[sizeof files / sizeof *files];
    int count = r.short_form ? 1 : (int)(sizeof files / sizeof *files), finest = count - 1;
    for (int i = 0; i < count; i++) found[i] = run_or_fail(&r, files[i]);
    for (int i = 0; i < finest; i++)
        if (found[i].nodes > 0 && found[finest].nodes > 0) compare(&r, &found[i], &found[finest]);
    if (r.short_form) rows_compare(&r, "punctures", "skin and capsule", found[0].punctures, 2, 0.0, NULL);
    return rows_end(&r);
}
