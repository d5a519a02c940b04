/* Tests needle and tissue together against laws that hold for all parameters: equilibrium of forces and moments, the exact axial force curve in homogeneous
   tissue, reversibility below the friction limit, repeatable insertions, and exit on the far side. */
#include "lockstep.h"
#include "refinement/refined_mesh.h"
#include "rows.h"

static const double TICK = 1e-3;              /* s */
static const double FRICTION = 8.0, CUTTING = 0.4, SKIN = 1.0; /* N/m, N and N, for the homogeneous tissue */

/* Creates a scene with one material, no viscous terms, and equal static and kinetic friction, so that the axial force curve is known. The capsule resists no
   more than the tissue. */
static simulation_config homogeneous(void) {
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->youngs_modulus = 30e3;
        m->cutting_viscosity = m->friction_viscous = 0.0;
        m->cutting_force = CUTTING;
        m->friction_static = m->friction_kinetic = FRICTION;
    }
    c.membranes[0].puncture_force = SKIN;
    c.membrane_count = 1;
    return c;
}

/* ---- equilibrium -------------------------------------------------------------------------------------------------------- */

/* The resultant of the needle's forces on the tissue, or of the reactions K u at the fixed nodes. As in linear elasticity, moments are about the origin,
   with forces at nominal positions. */
typedef struct { vec3 force, moment; } resultant;

static void add_to(resultant *sum, vec3 x, vec3 force) {
    sum->force = v3_add(sum->force, force);
    sum->moment = v3_add(sum->moment, v3_cross(x, force));
}

static resultant load_on_tissue(const lockstep *l) {
    const mesh *m = &l->parts.mesh;
    vec3 *nominal = calloc((size_t)m->node_count, sizeof *nominal), added[MAX_CONTACTS];
    resultant sum = {0};
    insertion_forces(&l->parts.insertion, &l->state, nominal, added);
    for (int i = 0; i < m->node_count; i++) add_to(&sum, m->nodes[i], nominal[i]);
    for (int i = 0; i < contacts_active(&l->state); i++) add_to(&sum, l->state.refined.nodes[i].position, added[i]);
    free(nominal);
    return sum;
}

static double first_lame(const lockstep *l, int region) {
    const region_material *material = &l->parts.materials[region];
    return material->youngs_modulus * material->poisson_ratio / ((1.0 + material->poisson_ratio) * (1.0 - 2.0 * material->poisson_ratio));
}

static double divergence_in(const mesh *m, int e, const vec3 *u, double *volume) {
    vec3 x[4], g[4];
    double sum = 0.0;
    for (int a = 0; a < 4; a++) x[a] = m->nodes[m->tets[e][a]];
    *volume = tet_gradients(x, g);
    for (int a = 0; a < 4; a++) sum += v3_dot(g[a], u[m->tets[e][a]]);
    return sum;
}

/* Returns the volumetric stress of each nominal element: lambda times the mean of div u at its corners. The value at a corner is the volume-weighted mean
   over the elements of one region around it. The caller frees the array. */
static double *averaged_stress(const lockstep *l, const vec3 *u) {
    const mesh *m = &l->parts.mesh;
    double *stress = calloc((size_t)m->tet_count, sizeof *stress), *sum = calloc(2 * (size_t)m->node_count, sizeof *sum);
    for (int region = 0; region < m->group_count; region++) {
        double *whole = sum + m->node_count, volume;
        memset(sum, 0, 2 * (size_t)m->node_count * sizeof *sum);
        for (int e = 0; e < m->tet_count; e++) {
            double divergence = divergence_in(m, e, u, &volume);
            for (int a = 0; a < 4 && m->region[e] == region; a++) sum[m->tets[e][a]] += volume * divergence, whole[m->tets[e][a]] += volume;
        }
        for (int e = 0; e < m->tet_count; e++)
            for (int a = 0; a < 4 && m->region[e] == region; a++)
                stress[e] += 0.25 * first_lame(l, region) * sum[m->tets[e][a]] / whole[m->tets[e][a]];
    }
    free(sum);
    return stress;
}

/* Returns the stress if it is lambda times the volume-weighted mean of div u over the element's patch. */
static double *patch_stress(const lockstep *l, const vec3 *u) {
    const mesh *m = &l->parts.mesh;
    const int *patch = l->parts.tissue.patch;
    double *stress = calloc((size_t)m->tet_count, sizeof *stress), *sum = calloc(2 * (size_t)m->tet_count, sizeof *sum);
    double *whole = sum + m->tet_count, volume;
    for (int e = 0; e < m->tet_count; e++) {
        double divergence = divergence_in(m, e, u, &volume);
        sum[patch[e]] += volume * divergence;
        whole[patch[e]] += volume;
    }
    for (int e = 0; e < m->tet_count; e++) stress[e] = first_lame(l, m->region[e]) * sum[patch[e]] / whole[patch[e]];
    free(sum);
    return stress;
}

/* Integrates the stress over the elements of the refined mesh, whose gradients are computed here from shape functions. */
static resultant reaction_of_fixed_nodes(lockstep *l) {
    const mesh *m = &l->parts.mesh;
    refinement refined;
    refined_mesh whole;
    trocar_error why;
    resultant sum = {0};
    insertion_refinement(&l->state, &refined);
    if (refined_mesh_create(m, &refined, &whole, &why) != TROCAR_OK) exit(2);
    vec3 *u = calloc((size_t)whole.node_count, sizeof *u);
    run_displacement(&l->run, &l->state, u, u + m->node_count);
    volumetric_strain strain = l->parts.config.volumetric;
    double *averaged = strain == STRAIN_BY_NODE ? averaged_stress(l, u) : strain == STRAIN_BY_PATCH ? patch_stress(l, u) : NULL;
    for (int e = 0; e < whole.tet_count; e++) {
        const region_material *material = &l->parts.materials[m->region[whole.parent[e]]];
        double nu = material->poisson_ratio, mu = material->youngs_modulus / (2.0 * (1.0 + nu));
        vec3 x[4], g[4];
        for (int a = 0; a < 4; a++) x[a] = whole.nodes[whole.tets[e][a]];
        double volume = tet_gradients(x, g), gradient[3][3] = {{0}};
        for (int a = 0; a < 4; a++) {
            vec3 d = u[whole.tets[e][a]];
            const double du[3] = {d.x, d.y, d.z}, dg[3] = {g[a].x, g[a].y, g[a].z};
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) gradient[i][j] += du[i] * dg[j];
        }
        mat3 stress;
        double trace = gradient[0][0] + gradient[1][1] + gradient[2][2];
        double volumetric = averaged ? averaged[whole.parent[e]] : first_lame(l, m->region[whole.parent[e]]) * trace;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) stress.m[i][j] = mu * (gradient[i][j] + gradient[j][i]) + (i == j ? volumetric : 0.0);
        for (int a = 0; a < 4; a++)
            if (whole.tets[e][a] < m->node_count && l->parts.tissue.fixed[whole.tets[e][a]])
                add_to(&sum, x[a], v3_scale(volume, m3_apply(&stress, g[a])));
    }
    free(u);
    free(averaged);
    refined_mesh_free(&whole);
    return sum;
}

static double apart(vec3 a, vec3 b) { return v3_norm(v3_sub(a, b)) / v3_norm(b); }

static const vec3 ways[] = {{0, 0, 0.03}, {0.001, 0.001, 0.025}, {0.002, 0.006, 0.005}, {-0.001, 0.002, -0.01}, {0.001, -0.003, -0.02}};
enum { WAYS = sizeof ways / sizeof *ways };

static void check_forces(rows *r, volumetric_strain strain) {
    simulation_config c = lockstep_config();
    c.volumetric = strain;
    const char *name = strain == STRAIN_BY_ELEMENT ? ", strain by element" : strain == STRAIN_BY_NODE ? ", strain by node" : "";
    char check[128];
    c.needle.bevel_slope = 0.03;
    lockstep *l = lockstep_create(&c, lockstep_start());
    double base = 0.0, force = 0.0, moment = 0.0;
    for (int k = 0; k < WAYS; k++) {
        lockstep_move(l, ways[k], 0.4, TICK);
        resultant load = load_on_tissue(l), reaction = reaction_of_fixed_nodes(l);
        vec3 borne = v3_sub(l->wrench.force, l->state.tip.dent.damping);
        base = fmax(base, apart(v3_scale(-1, load.force), borne));
        force = fmax(force, apart(reaction.force, borne));
        moment = fmax(moment, apart(v3_scale(-1, reaction.moment), load.moment));
    }
    snprintf(check, sizeof check, "force of base and damper at the tip against the forces on the tissue, %d states%s", WAYS, name);
    rows_error(r, check, "equal and opposite", base, 1e-6);
    snprintf(check, sizeof check, "force of base and damper against the reaction of the fixed nodes%s", name);
    rows_error(r, check, "stress in their elements", force, 1e-6);
    snprintf(check, sizeof check, "moment of the forces on the tissue against that of the reaction%s", name);
    rows_error(r, check, "stress in the elements of the fixed nodes", moment, 1e-6);
    lockstep_free(l);
}

/* Lets Newton's method run until nothing changes, instead of stopping at 1e-8 m. */
static void converge(simulation_config *c) {
    c->insertion.max_passes = 20;
    c->insertion.tolerance = 1e-15;
}

/* Compares the torque on the base with the sum of the contacts' moments, and with the bending moment at the base, which follows from the needle's shape
   alone. */
static void check_bending(rows *r) {
    for (int converged = 0; converged < 2; converged++) {
        simulation_config c = lockstep_config();
        c.needle.bevel_slope = 0.03;
        if (converged) converge(&c);
        lockstep *l = lockstep_create(&c, lockstep_start());
        double worst = 0.0;
        for (int k = 0; k < WAYS; k++) {
            lockstep_move(l, ways[k], 0.4, TICK);
            double off = v3_norm(v3_sub(needle_root_moment(&l->parts.needle, &l->state.needle), l->wrench.torque));
            worst = fmax(worst, off / (converged ? v3_norm(l->wrench.torque) : v3_norm(l->wrench.force) * c.needle.length));
        }
        rows_error(r, converged ? "base torque against bending at the base, equilibrium to the last digit"
                                : "base torque against bending at the base, over force times length; equilibrium to 1e-8 m, as by default",
                   "elastic moment of the needle's shape", worst, 1e-6);
        lockstep_free(l);
    }
}

/* ---- the axial curve ------------------------------------------------------------------------------------------------------ */

static bool whole_shaft_slides(const lockstep *l, friction_state way) {
    for (int k = 0; k < contacts_active(&l->state); k++)
        if (l->state.contacts[k].shaft.friction != way) return false;
    return contacts_active(&l->state) > 0 && l->state.tip.solved.friction == way && l->state.tip.shaft.friction == way && l->state.tip.barrier.blocked_by == NOT_BLOCKED;
}

/* Returns the largest error in the axial force during a move in which the whole shaft slides, relative to friction times depth plus, during insertion, the
   cutting force. */
static double curve_error(lockstep *l, double way, friction_state slides, int *ticks, double *depth, double *force, int *count) {
    double worst = 0.0;
    int n = (int)(fabs(way) / 2e-5 + 0.5);
    for (int i = 0; i < n; i++) {
        lockstep_move(l, v3(0, 0, way / n), TICK, TICK);
        if (i % 50 == 0) depth[*count] = 1e3 * l->wrench.depth, force[(*count)++] = -l->wrench.force.z;
        if (!whole_shaft_slides(l, slides) || l->wrench.events) continue;
        double expected = slides * FRICTION * l->wrench.depth + (slides == SLIP_FORWARD ? CUTTING : 0.0);
        worst = fmax(worst, fabs(-l->wrench.force.z - expected));
        (*ticks)++;
    }
    return worst;
}

/* Returns the tissue's compliance (m/N) at the entry point, from a separate solve. Before puncture, needle and tissue act in series, which gives the
   increase in force. */
static double compliance_at_entry(lockstep *l) {
    const mesh *m = &l->parts.mesh;
    vec3 *force = calloc((size_t)m->node_count, sizeof *force), *u = calloc((size_t)m->node_count, sizeof *u);
    double weights[4], sum = 0.0;
    int tet = l->state.tip.place.tet;
    mesh_barycentric(m, tet, l->state.entry, weights);
    for (int c = 0; c < 4; c++) force[m->tets[tet][c]].z = weights[c];
    inverse_apply(l->parts.inverse, force, u);
    for (int c = 0; c < 4; c++) sum += weights[c] * u[m->tets[tet][c]].z;
    free(force);
    free(u);
    return sum + l->run.workspace->tissue.axial[0]; /* adds the local compliance of the end face */
}

static void check_rise(rows *r) {
    simulation_config c = homogeneous();
    lockstep *l = lockstep_create(&c, lockstep_start());
    double touch = NAN, last = 0.0, base = 0.0;
    for (int i = 0; i < 4000 && !(l->wrench.events & EVENT_PUNCTURED); i++) {
        last = -l->wrench.force.z;
        base = l->base.position.z;
        lockstep_move(l, v3(0, 0, 1e-5), TICK, TICK);
        if (l->wrench.events & EVENT_TOUCHED) touch = l->state.entry.z - c.needle.length;
    }
    rows_compare(r, "force of the last tick before the puncture", "puncture force of the skin", last, SKIN, 0.01, "N");
    rows_compare(r, "stiffness before the puncture", "entry point's compliance by a static solve", last / (base - touch), 1.0 / compliance_at_entry(l), 0.01, "N/m");
    lockstep_free(l);
}

static void check_axial_curve(rows *r) {
    simulation_config c = homogeneous();
    lockstep *l = lockstep_create(&c, lockstep_start());
    double depth[400], force[400], exact[400];
    int in_ticks = 0, out_ticks = 0, count = 0;
    double in = curve_error(l, 0.081, SLIP_FORWARD, &in_ticks, depth, force, &count);
    double out = curve_error(l, -0.085, SLIP_BACKWARD, &out_ticks, depth, force, &count);
    rows_add(r, (row){.check = "insertion by 80 mm: worst force while the whole shaft slides", .reference = "cutting + friction times depth", .value = in,
                      .expected = 0.0, .error = in / (CUTTING + 0.08 * FRICTION), .limit = 1e-3, .unit = "N", .note = "error relative to the largest force"});
    rows_add(r, (row){.check = "retraction: worst force while the whole shaft slides", .reference = "friction times depth", .value = out, .expected = 0.0,
                      .error = out / (0.08 * FRICTION), .limit = 1e-3, .unit = "N", .note = "error relative to the largest force"});
    double part = (double)in_ticks / (0.08 / 2e-5);
    rows_add(r, (row){.check = "share of the insertion during which the whole shaft slides", .reference = "at least half", .value = part, .expected = NAN,
                      .error = 1.0 - part, .limit = 0.5, .note = "absolute; the check above applies there"});
    rows_curve(r, (curve){.figure = "axial-curve", .label = "simulated, in and out", .x_label = "depth (mm)", .y_label = "push at the base (N)",
                          .count = count, .x = depth, .y = force});
    for (int i = 0; i < count; i++) exact[i] = CUTTING + 1e-3 * FRICTION * depth[i];
    rows_curve(r, (curve){.figure = "axial-curve", .label = "cutting + friction times depth", .x_label = "depth (mm)", .y_label = "push at the base (N)",
                          .count = count / 2, .x = depth, .y = exact});
    lockstep_free(l);
}

/* ---- reversibility, repetition, exit ---------------------------------------------------------------------------------------- */

static void check_reversibility(rows *r, bool converged, double limit) {
    simulation_config c = homogeneous();
    if (converged) converge(&c);
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.07), 1.0, TICK);
    lockstep_move(l, v3(0, 0, -0.0001), 0.1, TICK); /* unloads the needle, so that nothing slides */
    tick_output before = l->wrench;
    double swing = 0.0, twist = 0.0, force = 0.0, torque = 0.0;
    for (int i = 0; i < 5; i++) {
        lockstep_move(l, v3(2e-5, 4e-5, -2e-5), 0.05, TICK);
        swing = fmax(swing, v3_norm(v3_sub(l->wrench.force, before.force)));
        twist = fmax(twist, v3_norm(v3_sub(l->wrench.torque, before.torque)));
        lockstep_move(l, v3(-2e-5, -4e-5, 2e-5), 0.05, TICK);
        force = fmax(force, v3_norm(v3_sub(l->wrench.force, before.force)));
        torque = fmax(torque, v3_norm(v3_sub(l->wrench.torque, before.torque)));
    }
    char check[160];
    const char *how = converged ? "to the last digit" : "to 1e-8 m of the 5e-5 m moved, as by default";
    snprintf(check, sizeof check, "below the friction limit, there and back 5 times: force over its swing, equilibrium %s", how);
    rows_error(r, check, "as before", force / swing, limit);
    snprintf(check, sizeof check, "the same: torque, equilibrium %s", how);
    rows_error(r, check, "as before", torque / twist, limit);
    lockstep_free(l);
}

enum { SAMPLES = 80 };

static void push_and_pull(lockstep *l, double *force) {
    for (int i = 0; i < SAMPLES; i++) {
        lockstep_move(l, v3(0, 0, i < SAMPLES / 2 ? 0.0018 : -0.0018), 0.05, TICK);
        force[i] = l->wrench.force.z;
    }
}

/* Inserts and withdraws ten times at the same point, each time after cutting a track 3 mm away, and compares the forces with the first time's. The tissue
   closes behind the tip here, because in an open track, the next insertion would not cut. */
static void check_repetition(rows *r) {
    simulation_config c = lockstep_config();
    c.insertion.track_reach = 0.0;
    lockstep *l = lockstep_create(&c, lockstep_start());
    double first[SAMPLES], force[SAMPLES], beside[SAMPLES], beside_first[SAMPLES], peak = 0.0, worst = 0.0, worst_beside = 0.0, left = 0.0;
    for (int round = 0; round < (r->short_form ? 3 : 10); round++) {
        push_and_pull(l, round == 0 ? first : force);
        left = fmax(left, v3_norm(l->wrench.force));
        lockstep_move(l, v3(0.003, 0, 0), 0.1, TICK);
        push_and_pull(l, round == 0 ? beside_first : beside);
        left = fmax(left, v3_norm(l->wrench.force));
        lockstep_move(l, v3(-0.003, 0, 0), 0.1, TICK);
        for (int i = 0; i < SAMPLES; i++) {
            peak = fmax(peak, fabs(first[i]));
            if (round == 0) continue;
            worst = fmax(worst, fabs(force[i] - first[i]));
            worst_beside = fmax(worst_beside, fabs(beside[i] - beside_first[i]));
        }
    }
    rows_error(r, "ten insertions along one track that closes: force", "the first time", worst / peak, 1e-6);
    rows_error(r, "ten insertions, with a neighbouring track before each: force", "the first time", worst_beside / peak, 1e-6);
    rows_error(r, "remaining force after withdrawal, N", "0", left, 0.0);
    lockstep_free(l);
}

/* Inserts along x through the side of the body, where the path is 100 mm long. */
static void check_exit(rows *r) {
    simulation_config c = homogeneous();
    lockstep *l = lockstep_create(&c, (pose){v3(-0.2505, 0.0, 0.03), q_exp(v3(0, M_PI / 2, 0))});
    double worst = 0.0, worst_back = 0.0, depth = 0.0;
    for (int round = 0; round < 2; round++) {
        int exited = 0;
        for (int i = 0; i < 14500; i++) {
            lockstep_move(l, v3(1e-5, 0, 0), TICK, TICK);
            if (l->state.tip.place.phase == TIP_BEYOND) exited++;
            if (exited > 2000) worst = fmax(worst, fabs(-l->wrench.force.x / (FRICTION * 0.1) - 1.0));
        }
        depth = l->wrench.depth;
        lockstep_move(l, v3(-0.020, 0, 0), 1.0, TICK);
        worst_back = fmax(worst_back, fabs(l->wrench.force.x / (FRICTION * 0.1) - 1.0));
        lockstep_move(l, v3(-0.125, 0, 0), 4.0, TICK);
    }
    rows_compare(r, "needle out on the far side: length in tissue", "thickness", depth, 0.1, 1e-3, "m");
    rows_error(r, "pushed on by 2 mm: force, twice", "friction times the thickness, no cutting", worst, 1e-2);
    rows_error(r, "pulled back by 20 mm, tip still outside: force, twice", "the same, reversed", worst_back, 1e-2);
    rows_error(r, "withdrawn completely: remaining force, N", "0", v3_norm(l->wrench.force), 0.0);
    lockstep_free(l);
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: equilibrium");
    check_forces(&r, STRAIN_BY_PATCH);
    check_forces(&r, STRAIN_BY_NODE);
    check_forces(&r, STRAIN_BY_ELEMENT);
    check_bending(&r);
    r.section = "Coupled: straight axial insertion in homogeneous tissue";
    check_rise(&r);
    check_axial_curve(&r);
    r.section = "Coupled: reversibility, repetition, exit";
    check_reversibility(&r, false, 2e-4);
    check_reversibility(&r, true, 1e-6);
    check_repetition(&r);
    if (!r.short_form) check_exit(&r);
    return rows_end(&r);
}
