/* Computes the force on a rigid straight needle that displaces the tissue, from the insertion's contact nodes, tributary lengths and local compliances. For
   comparison with a needle whose surface is resolved by the mesh (resolved_needle.py).
   usage: rigid_needle MESH RADIUS NU X Y TIP_Z YOUNGS_MODULUS YOUNGS_MODULUS_OF_"lower" [ANGLE AZIMUTH | STIFFENING | skin N_PER_M NU]
   X Y TIP_Z: position of the tip. The needle enters at the top (z = 0.1 m), either along -z or obliquely, at ANGLE degrees to the top and towards AZIMUTH
   degrees from x. Prints the number of nodes, the number of contacts, and the tick's own forces (N) for a motion by 1 mm: sideways (x; oblique: in the
   vertical plane of the needle), along the needle, and across (y; oblique: horizontally). Then, unless the needle is oblique, prints the sums of the springs
   in each direction: sideways, along, and that of the tip alone along z. With STIFFENING (C20 / C10), prints instead the number of nodes, the number of
   contacts, and the forces along the needle for motions by 1, 2, 3, 4 and 5 mm. With `skin`, this surface is a membrane with a stiffness and a Poisson's
   ratio. */
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "insertion/model/local_compliance.h"
#include "insertion/state/shaft.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip.h"
#include "oracles/run.h"
#include "snapshot/snapshot_kernels.h"

typedef struct {
    model_parts parts;
    needle_run run;
    insertion_state state;
    compliance_snapshot snapshot;
} body;

static const double RIGID = 1e7;   /* factor on the modulus of steel */
enum { DEEPER = 5, STEPS_PER_MM = 20 };
static const double HOLDS = 1e6;   /* N/m and N, large enough to prevent sliding and cutting */

static trocar_status configure(char **argument, simulation_config *c, trocar_error *why) {
    mesh m;
    simulation_defaults(c);
    snprintf(c->mesh_path, sizeof c->mesh_path, "%s", argument[1]);
    trocar_status status = mesh_read(c->mesh_path, &m, why);
    if (status != TROCAR_OK) return status;
    for (int g = 0; g < m.group_count; g++) {
        if (m.groups[g].dimension != 3) continue;
        region_config *region = &c->regions[c->region_count++];
        memcpy(region->name, m.groups[g].name, sizeof region->name);
        region->material = region_defaults();
        region->material.poisson_ratio = atof(argument[3]);
        region->material.youngs_modulus = atof(strcmp(region->name, "lower") == 0 ? argument[8] : argument[7]);
        region->material.stiffening = argument[9] && !argument[10] ? atof(argument[9]) : 0.0;
        region->material.friction_static = region->material.friction_kinetic = HOLDS;
        region->material.cutting_force = HOLDS;
    }
    mesh_free(&m);
    if (argument[9] && strcmp(argument[9], "skin") == 0)
        c->membranes[c->membrane_count++] = (membrane_config){.name = "skin", .material = {.stiffness = atof(argument[10]), .poisson_ratio = atof(argument[11])}};
    c->inverse = INVERSE_SPARSE; /* the fastest kind to create on coarse meshes */
    snprintf(c->fixed[c->fixed_count++], MESH_NAME, "fixed");
    c->needle.outer_diameter = 2.0 * atof(argument[2]);
    c->needle.inner_diameter = 0.5 * c->needle.outer_diameter;
    c->needle.youngs_modulus *= RIGID;
    return TROCAR_OK;
}

/* Returns the local compliance along a world axis (the third is the needle's) at a point that stands for the shaft between two depths. The regions along
   this part of the shaft act in parallel. */
static double local_between(const insertion_model *model, const insertion_state *s, const resolved_field *resolved, double from, double to, int axis) {
    lateral_axial logarithm = local_logarithm(model, resolved);
    bool along = axis == 2;
    double stiffness = 0.0;
    for (int k = 0; k < s->stratum_count; k++) {
        double top = fmax(from, s->strata[k].depth), bottom = k + 1 < s->stratum_count ? fmin(to, s->strata[k + 1].depth) : to;
        lateral_axial line = local_line_stiffness(&model->materials[s->strata[k].region]);
        stiffness += fmax(bottom - top, 0.0) * (along ? line.axial : line.lateral);
    }
    double end = line_end_at(&resolved->end, s->tip.place.depth - 0.5 * (from + to));
    return (along ? logarithm.axial : logarithm.lateral + resolved->uneven.m[axis][axis] + end) / stiffness;
}

/* Assembles the compliance of the points (contacts, then tip) along one world axis, local compliances included. */
static int assemble(const body *b, int axis, double *a, double *tip_alone) {
    const insertion_state *s = &b->state;
    const insertion_model *model = &b->parts.insertion;
    int contacts = contacts_passed(s), n = contacts + 1, handles[4];
    const int *corners = model->mesh->tets[s->tip.place.tet];
    double weights[4], own = 0.0;
    static insertion_state all; /* every contact active */
    all = *s;
    for (int i = 0; i < contacts; i++) all.contacts[all.refined.order[i]].status = CONTACT_ACTIVE;
    mesh_barycentric(model->mesh, s->tip.place.tet, s->tip.place.nominal, weights);
    const line_piece *piece = snapshot_piece(&b->snapshot, s->tip.place.tet);
    if (!snapshot_covers(&b->snapshot, corners, handles) || !piece) return 0;
    resolved_field resolved = piece_at(piece, s->tip.place.nominal);
    for (int i = 0; i < contacts; i++) {
        for (int j = 0; j < contacts; j++) a[i * n + j] = compliance_between(&b->snapshot, i, j).m[axis][axis];
        a[i * n + contacts] = a[contacts * n + i] = compliance_to_point(&b->snapshot, handles, weights, i).m[axis][axis];
        shaft_share share = shaft_share_of(&all, i, true);
        a[i * n + i] += local_between(model, s, &b->snapshot.resolved[i], share.from, share.to, axis);
    }
    for (int c = 0; c < 4; c++) own += weights[c] * compliance_to_point(&b->snapshot, handles, weights, handles[c]).m[axis][axis];
    shaft_share share = shaft_share_of(&all, contacts, true);
    double disc = local_at_tip(model, s->tip.place.tet, s->tip.place.nominal, s->tip.place.depth, 0.0, resolved.point);
    double shaft = local_between(model, s, &resolved, share.from, share.to, axis);
    a[contacts * n + contacts] = own + 1.0 / (1.0 / shaft + 1.0 / disc); /* in parallel */
    *tip_alone = 1e-3 / (own + disc);
    return n;
}

/* Returns the total force when all points move by 1 mm. */
static double total_force(const body *b, int axis, double *tip_alone) {
    static double a[(MAX_CONTACTS + 1) * (MAX_CONTACTS + 1)], x[MAX_CONTACTS + 1];
    lapack_int pivots[MAX_CONTACTS + 1];
    int n = assemble(b, axis, a, tip_alone);
    double sum = 0.0;
    for (int i = 0; i < n; i++) x[i] = 1e-3;
    if (n == 0 || LAPACKE_dgesv(LAPACK_ROW_MAJOR, n, 1, a, n, pivots, x, 1) != 0) return NAN;
    for (int i = 0; i < n; i++) sum += x[i];
    return sum;
}

/* Computes the tick's axial forces (N) as the needle is moved by 1 to 5 mm in steps. */
static trocar_status forces_deeper(body *b, pose base, vec3 way, double *force, trocar_error *why) {
    tick_output wrench;
    double rest = 0.0;
    insertion_reset(&b->parts.insertion, base, &b->state);
    trocar_status status = TROCAR_OK;
    for (int i = -2; i <= DEEPER * STEPS_PER_MM && status == TROCAR_OK; i++) {
        pose moved = base;
        moved.position = v3_axpy(1e-3 * fmax(i, 0) / STEPS_PER_MM, way, base.position);
        status = run_step(&b->run, (tick_input){.base = {.pose = moved}, .dt = 1e-3}, &b->state, &b->snapshot, &wrench, why);
        double now = -v3_dot(way, wrench.force);
        if (i == 0) rest = now;
        if (i > 0 && i % STEPS_PER_MM == 0) force[i / STEPS_PER_MM - 1] = now - rest;
    }
    return status;
}

/* Computes the total force with the tick, as the change in the wrench when the base moves by 1 mm with all contacts sticking. (The wrench at rest is not
   exactly zero, because nodes are kept away from element faces and therefore lie slightly off the needle.) */
static trocar_status force_of_tick(body *b, pose base, vec3 way, double *force, trocar_error *why) {
    tick_output wrench;
    insertion_reset(&b->parts.insertion, base, &b->state);
    trocar_status status = TROCAR_OK;
    *force = 0.0;
    for (int i = 0; i < 3 && status == TROCAR_OK; i++) { /* contacts become active in the second tick, and the base moves in the third */
        if (i == 2) base.position = v3_axpy(1e-3, way, base.position);
        status = run_step(&b->run, (tick_input){.base = {.pose = base}, .dt = 1e-3}, &b->state, &b->snapshot, &wrench, why);
        if (i > 0) *force = -v3_dot(way, wrench.force) - *force;
    }
    return status;
}

/* Returns the base pose for a tip at the distance `length` from it. The needle points along the base's z axis; "sideways" is the base's x axis, "across" its
   y axis. */
static pose base_of(vec3 tip, double length, double angle, double azimuth) {
    pose base = {tip, {0, 1, 0, 0}}; /* turned about x, so that the needle points along -z */
    quat lean = q_multiply(q_exp(v3(0, 0, azimuth)), q_exp(v3(0, angle - M_PI_2, 0)));
    base.orientation = q_multiply(lean, base.orientation);
    base.position = v3_axpy(-length, q_rotate(base.orientation, v3(0, 0, 1)), tip);
    return base;
}

static trocar_status start(body *b, char **argument, bool oblique, pose *base, trocar_error *why) {
    simulation_config config;
    trocar_status status = configure(argument, &config, why);
    if (status == TROCAR_OK) status = model_parts_create(&config, &b->parts, why);
    if (status == TROCAR_OK) status = run_create(&b->parts, &b->run, why);
    if (status != TROCAR_OK) return status;
    double angle = oblique ? atof(argument[9]) : 90.0, azimuth = oblique ? atof(argument[10]) : 0.0;
    vec3 tip = v3(atof(argument[4]), atof(argument[5]), atof(argument[6]));
    *base = base_of(tip, config.needle.length, angle * M_PI / 180.0, azimuth * M_PI / 180.0);
    insertion_reset(&b->parts.insertion, *base, &b->state);
    return remesher_answer(b->run.remesher, &b->state.request, &b->snapshot, why);
}

int main(int argc, char **argv) {
    trocar_error why;
    pose base;
    bool oblique = argc == 11, stiffening = argc == 10, skin = argc == 12 && strcmp(argv[9], "skin") == 0;
    body *b = calloc(1, sizeof *b);
    if ((argc != 9 && !oblique && !stiffening && !skin) || !b) {
        fprintf(stderr, "usage: rigid_needle MESH RADIUS NU X Y TIP_Z YOUNGS_MODULUS YOUNGS_MODULUS_OF_LOWER [ANGLE AZIMUTH | STIFFENING | skin N_PER_M NU]\n");
        return 2;
    }
    trocar_status status = start(b, argv, oblique, &base, &why);
    double tip_alone, springs_sideways = NAN, springs_along = NAN, force[3];
    if (stiffening && status == TROCAR_OK) {
        double deeper[DEEPER];
        status = forces_deeper(b, base, v3(0, 0, -1), deeper, &why);
        if (status == TROCAR_OK) printf("%d %d %.6g %.6g %.6g %.6g %.6g\n", b->parts.mesh.node_count, contacts_passed(&b->state), deeper[0], deeper[1], deeper[2], deeper[3], deeper[4]);
        else fprintf(stderr, "rigid_needle: %s\n", why.text);
        return status == TROCAR_OK ? 0 : 2;
    }
    if (status == TROCAR_OK && !oblique) {
        springs_sideways = total_force(b, 0, &tip_alone);
        springs_along = total_force(b, 2, &tip_alone);
    }
    const vec3 ways[3] = {v3(1, 0, 0), v3(0, 0, 1), v3(0, 1, 0)}; /* of the base */
    for (int i = 0; i < 3 && status == TROCAR_OK; i++) status = force_of_tick(b, base, q_rotate(base.orientation, ways[i]), &force[i], &why);
    if (status != TROCAR_OK) {
        fprintf(stderr, "rigid_needle: %s\n", why.text);
        return 2;
    }
    printf("%d %d %.6g %.6g %.6g", b->parts.mesh.node_count, contacts_passed(&b->state), force[0], force[1], force[2]);
    if (!oblique) printf(" %.6g %.6g %.6g", springs_sideways, springs_along, tip_alone);
    printf("\n");
    return 0;
}
