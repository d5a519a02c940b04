/* The needle as a solid of linear tetrahedra with quadratic (Green-Lagrange) strain and the St. Venant-Kirchhoff
   material. A section has a centre node and four rim nodes; each of the four prisms between two sections is split into three tetrahedra, in a pattern that is
   symmetric under quarter turns, so that bending stiffness is the same in all directions:

           section above        diagonals of the prism of rim nodes i and i + 1, from below to above:
              1   0                centre - rim i   (with its neighbour: centre - rim i + 1)
               \ /                 rim i  - rim i + 1
                c                and for the next layer the mirror image, from above to below, so that
               / \               a pull does not twist the needle.
              2   3

   Such flat elements lock, because they can represent bending mostly as shear. Young's modulus is scaled so that the deflection under a small tip
   load equals the rod's; this also makes extension softer (docs/mechanics.md, "Tetrahedra"). */
#include "oracles/needle_solid.h"

#include <stdlib.h>
#include <string.h>

#include "base/lame.h"

/* ---- the mesh -------------------------------------------------------------------------------------------------------- */

/* Returns a node of a layer. In mirrored layers, the upper and lower sections are swapped. */
static int layer_node(bool above, bool mirrored, int node) { return (above != mirrored ? SOLID_SECTION : 0) + node; }

static vec3 rest_of(const solid_model *model, int node) {
    int i = node % SOLID_SECTION;
    vec3 x = i == 0 ? v3(0, 0, 0) : model->solid.rim[i - 1];
    if (node >= SOLID_SECTION) x.z += model->line.segment_length;
    return x;
}

static void find_gradients(const solid_model *model, layer_tet *tet) {
    vec3 origin = rest_of(model, tet->nodes[3]), x[3];
    for (int a = 0; a < 3; a++) x[a] = v3_sub(rest_of(model, tet->nodes[a]), origin);
    mat3 edges = m3_columns(x[0], x[1], x[2]), inverse = m3_inverse(&edges);
    tet->gradients[3] = v3(0, 0, 0);
    for (int a = 0; a < 3; a++) {
        tet->gradients[a] = v3(inverse.m[a][0], inverse.m[a][1], inverse.m[a][2]);
        tet->gradients[3] = v3_sub(tet->gradients[3], tet->gradients[a]);
    }
}

static void build_layer(solid_model *model, bool mirrored, layer_tet *tets) {
    for (int i = 0; i < SOLID_RIM; i++) {
        int p = 1 + i, q = 1 + (i + 1) % SOLID_RIM; /* the rim nodes of this prism */
        int c = layer_node(false, mirrored, 0), p0 = layer_node(false, mirrored, p), q0 = layer_node(false, mirrored, q);
        int d = layer_node(true, mirrored, 0), p1 = layer_node(true, mirrored, p), q1 = layer_node(true, mirrored, q);
        const int nodes[3][4] = {{c, d, p1, q1}, {c, p0, q0, q1}, {c, p0, q1, p1}};
        for (int t = 0; t < 3; t++) {
            memcpy(tets[3 * i + t].nodes, nodes[t], sizeof nodes[t]);
            find_gradients(model, &tets[3 * i + t]);
        }
    }
}

static void build_mesh(solid_model *model) {
    solid_mesh *solid = &model->solid;
    for (int i = 0; i < SOLID_RIM; i++) {
        double angle = 2.0 * M_PI * i / SOLID_RIM;
        solid->rim[i] = v3(model->line.radius * cos(angle), model->line.radius * sin(angle), 0);
    }
    double sector = 0.5 * model->line.radius * model->line.radius * sin(2.0 * M_PI / SOLID_RIM);
    solid->volume = sector * model->line.segment_length / 3.0;
    build_layer(model, false, solid->layers[0]);
    build_layer(model, true, solid->layers[1]);
}

/* ---- shape ----------------------------------------------------------------------------------------------------------- */

static vec3 position_of(const solid_state *state, int layer, int node) {
    int section = layer + node / SOLID_SECTION, i = node % SOLID_SECTION;
    return i == 0 ? state->line.joints[section] : state->rim[section][i - 1];
}

static void place_section(const solid_model *model, solid_state *state, int section) {
    vec3 along = v3(0, 0, section * model->line.segment_length);
    state->line.joints[section] = v3_add(state->line.base.position, q_rotate(state->line.base.orientation, along));
    for (int i = 0; i < SOLID_RIM; i++)
        state->rim[section][i] = v3_add(state->line.joints[section], q_rotate(state->line.base.orientation, model->solid.rim[i]));
}

/* Returns the quaternion of the orthonormal axes in the columns of m, computed from its largest component (Shepperd 1978). */
static quat q_of_axes(const mat3 *m) {
    double trace = m->m[0][0] + m->m[1][1] + m->m[2][2];
    if (trace > 0.0)
        return q_unit((quat){1.0 + trace, m->m[2][1] - m->m[1][2], m->m[0][2] - m->m[2][0], m->m[1][0] - m->m[0][1]});
    int i = m->m[1][1] > m->m[0][0] ? 1 : 0;
    if (m->m[2][2] > m->m[i][i]) i = 2;
    int j = (i + 1) % 3, k = (i + 2) % 3;
    double v[3];
    v[i] = 1.0 + m->m[i][i] - m->m[j][j] - m->m[k][k];
    v[j] = m->m[i][j] + m->m[j][i];
    v[k] = m->m[i][k] + m->m[k][i];
    return q_unit((quat){m->m[k][j] - m->m[j][k], v[0], v[1], v[2]});
}

/* Computes a segment's axis from its centre nodes, and its roll angle from the first two rim nodes at both ends. */
static void find_frames(const solid_model *model, solid_state *state) {
    for (int k = 0; k < model->line.given.segments; k++) {
        vec3 axis = v3_unit(v3_sub(state->line.joints[k + 1], state->line.joints[k]));
        vec3 x = v3_sub(v3_add(state->rim[k][0], state->rim[k + 1][0]), v3_add(state->rim[k][2], state->rim[k + 1][2]));
        x = v3_unit(v3_axpy(-v3_dot(x, axis), axis, x));
        mat3 axes = m3_columns(x, v3_cross(axis, x), axis);
        state->line.frames[k] = q_of_axes(&axes);
    }
}

void solid_rest(const solid_model *model, pose base, solid_state *state) {
    state->line.base = base;
    for (int k = 0; k <= model->line.given.segments; k++) place_section(model, state, k);
    for (int k = 0; k < model->line.given.segments; k++) state->line.frames[k] = base.orientation;
}

/* Rolls all sections together with the base. If only the first layer rolled, a fast roll would strain it so much that Newton's method would not converge
   within a tick. */
void solid_hold(const solid_model *model, pose base, solid_state *state) {
    vec3 shift = v3_sub(base.position, state->line.base.position);
    double roll = q_roll_between(state->line.base.orientation, base.orientation);
    for (int k = 1; k <= model->line.given.segments; k++) {
        quat about_axis = q_exp(v3_scale(roll, q_axis(state->line.frames[k - 1])));
        vec3 before = state->line.joints[k];
        state->line.joints[k] = v3_add(before, shift);
        for (int i = 0; i < SOLID_RIM; i++)
            state->rim[k][i] = v3_add(state->line.joints[k], q_rotate(about_axis, v3_sub(state->rim[k][i], before)));
    }
    state->line.base = base;
    place_section(model, state, 0);
    find_frames(model, state);
}

/* ---- one tetrahedron ------------------------------------------------------------------------------------------------- */

typedef struct {
    mat3 deformation;        /* F */
    mat3 stress;             /* second Piola-Kirchhoff, Pa */
    double energy;           /* J/m^3 */
} strained;

static mat3 deformation_of(const layer_tet *tet, const solid_state *state, int layer) {
    mat3 f = {{{0}}};
    vec3 origin = position_of(state, layer, tet->nodes[3]); /* the gradients add up to zero, so positions relative to a local origin reduce rounding errors */
    for (int a = 0; a < 3; a++) {
        vec3 x = v3_sub(position_of(state, layer, tet->nodes[a]), origin), g = tet->gradients[a];
        const double p[3] = {x.x, x.y, x.z}, q[3] = {g.x, g.y, g.z};
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) f.m[i][j] += p[i] * q[j];
    }
    return f;
}

/* Green-Lagrange strain E = (F^T F - 1) / 2, and stress lambda tr(E) + 2 mu E. */
static strained strain_tet(const solid_mesh *solid, const layer_tet *tet, const solid_state *state, int layer) {
    strained s = {.deformation = deformation_of(tet, state, layer)};
    mat3 back = m3_transposed(&s.deformation), strain = m3_multiply(&back, &s.deformation);
    double trace = 0.0;
    for (int i = 0; i < 3; i++) {
        strain.m[i][i] -= 1.0;
        for (int j = 0; j < 3; j++) strain.m[i][j] *= 0.5;
        trace += strain.m[i][i];
    }
    s.energy = 0.5 * solid->lambda * trace * trace;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            s.energy += solid->mu * strain.m[i][j] * strain.m[i][j];
            s.stress.m[i][j] = 2.0 * solid->mu * strain.m[i][j] + (i == j ? solid->lambda * trace : 0.0);
        }
    return s;
}

/* Returns the force on node a of the tetrahedron that balances its stress: V F S g_a. */
static vec3 nodal_force(const solid_mesh *solid, const layer_tet *tet, const strained *s, int a) {
    vec3 traction = m3_apply(&s->stress, tet->gradients[a]);
    return v3_scale(solid->volume, m3_apply(&s->deformation, traction));
}

/* Adds the derivative of the force on node a = nodes[0] with respect to the position of node b = nodes[1] to a 3 x 3 block of `out`. With F F^T in `spread`,
   the derivative is V [(g_a . S g_b) 1 + lambda (F g_a)(F g_b)^T + mu (F g_b)(F g_a)^T + mu (g_a . g_b) F F^T]. */
static void add_stiffness(const solid_mesh *solid, const layer_tet *tet, const strained *s, const mat3 *spread, const int nodes[2],
                          double (*out)[TRIDIAGONAL_LD]) {
    vec3 ga = tet->gradients[nodes[0]], gb = tet->gradients[nodes[1]];
    vec3 fa = m3_apply(&s->deformation, ga), fb = m3_apply(&s->deformation, gb);
    const double p[3] = {fa.x, fa.y, fa.z}, q[3] = {fb.x, fb.y, fb.z};
    double v = solid->volume, geometric = v * v3_dot(ga, m3_apply(&s->stress, gb));
    double lambda = v * solid->lambda, mu = v * solid->mu, cosine = mu * v3_dot(ga, gb);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) out[i][j] += lambda * p[i] * q[j] + mu * q[i] * p[j] + cosine * spread->m[i][j];
        out[i][i] += geometric;
    }
}

/* ---- the solid ------------------------------------------------------------------------------------------------------- */

/* Adds a tetrahedron's stiffness to the blocks of its two sections. The base section is fixed, so block k belongs to section k + 1. */
static void assemble_tet(const solid_mesh *solid, const layer_tet *tet, const strained *s, int layer, block_tridiagonal *chain) {
    mat3 turned = m3_transposed(&s->deformation), spread = m3_multiply(&s->deformation, &turned);
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) {
            int above_a = tet->nodes[a] / SOLID_SECTION, above_b = tet->nodes[b] / SOLID_SECTION;
            int block = layer + above_a - 1;
            if (above_a > above_b || block < 0) continue; /* symmetric part; fixed */
            double (*rows)[TRIDIAGONAL_LD] = above_a == above_b ? chain->diagonal[block] : chain->upper[block];
            int row = 3 * (tet->nodes[a] % SOLID_SECTION), column = 3 * (tet->nodes[b] % SOLID_SECTION);
            add_stiffness(solid, tet, s, &spread, (int[]){a, b}, (double (*)[TRIDIAGONAL_LD])&rows[row][column]);
        }
}

static void assemble(const solid_model *model, const solid_state *state, solid_tangent *tangent) {
    const solid_mesh *solid = &model->solid;
    block_tridiagonal *chain = &tangent->stiffness;
    int n = model->line.given.segments;
    chain->count = n;
    memset(chain->diagonal, 0, (size_t)n * sizeof *chain->diagonal);
    memset(chain->upper, 0, (size_t)n * sizeof *chain->upper);
    memset(tangent->internal, 0, (size_t)(n + 1) * sizeof *tangent->internal);
    for (int k = 0; k < n; k++)
        for (int t = 0; t < SOLID_LAYER_TETS; t++) {
            const layer_tet *tet = &solid->layers[k % 2][t];
            strained s = strain_tet(solid, tet, state, k);
            assemble_tet(solid, tet, &s, k, chain);
            for (int a = 0; a < 4; a++) {
                vec3 *f = &tangent->internal[k + tet->nodes[a] / SOLID_SECTION][tet->nodes[a] % SOLID_SECTION];
                *f = v3_add(*f, nodal_force(solid, tet, &s, a));
            }
        }
}

/* Computes the displacements of sections 1..n of the linearised needle under `load` on its centre nodes, or under no load if that is NULL. */
static void solve_step(int n, const solid_tangent *tangent, const vec3 *load, double (*step)[TRIDIAGONAL_ROWS]) {
    for (int k = 0; k < n; k++)
        for (int i = 0; i < SOLID_SECTION; i++) {
            vec3 f = v3_scale(-1.0, tangent->internal[k + 1][i]);
            if (load && i == 0) f = v3_add(f, load[k + 1]);
            memcpy(&step[k][3 * i], &f, sizeof f);
        }
    tridiagonal_solve(&tangent->stiffness, step);
}

void solid_linearise(const solid_model *model, const solid_state *state, const vec3 *load, int first,
                           solid_tangent *tangent) {
    (void)load; /* constant forces add no stiffness, and the shape already reflects the stress they cause */
    int n = model->line.given.segments;
    double step[NEEDLE_MAX_SEGMENTS][TRIDIAGONAL_ROWS];
    tangent->line.unstable = 0;
    assemble(model, state, tangent);
    tridiagonal_factor(&tangent->stiffness);
    solve_step(n, tangent, NULL, step);
    tangent->line.drift[0] = v3(0, 0, 0);
    for (int k = 0; k < n; k++) memcpy(&tangent->line.drift[k + 1], step[k], sizeof(vec3));
    for (int a = 0; a < 3; a++)
        for (int c = 0; c < 3 * (n + 1); c++) tangent->line.compliance[a][c] = tangent->line.compliance[c][a] = 0.0;
    tridiagonal_inverse_heads(&tangent->stiffness, first > 0 ? first - 1 : 0, &tangent->line.compliance[3][3], NEEDLE_LD);
}

/* ---- a step ---------------------------------------------------------------------------------------------------------- */

static vec3 step_of(double (*step)[TRIDIAGONAL_ROWS], int section, int node) {
    if (section == 0) return v3(0, 0, 0);
    const double *d = &step[section - 1][3 * node];
    return v3(d[0], d[1], d[2]);
}

/* Returns the least-squares rotation of a section from the displacements of its rim nodes. */
static vec3 rotation_of(const vec3 *arm, const vec3 *change) {
    mat3 inertia = {{{0}}};
    vec3 momentum = v3(0, 0, 0);
    for (int i = 0; i < SOLID_RIM; i++) {
        const double r[3] = {arm[i].x, arm[i].y, arm[i].z};
        momentum = v3_add(momentum, v3_cross(arm[i], change[i]));
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) inertia.m[a][b] += (a == b ? v3_dot(arm[i], arm[i]) : 0.0) - r[a] * r[b];
    }
    mat3 inverse = m3_inverse(&inertia);
    return m3_apply(&inverse, momentum);
}

/* Returns `arm` after `change`, whose rotational part `turn` is applied as a finite rotation. */
static vec3 turned_arm(vec3 arm, vec3 change, vec3 turn) {
    vec3 rest = v3_sub(v3_add(arm, change), v3_cross(turn, arm));
    return q_rotate(q_exp(turn), rest);
}

/* Moves the rim nodes of a section whose centre node has already been moved. Returns the rotation (rad). */
static double move_rim(solid_state *state, int section, vec3 centre_before, double (*step)[TRIDIAGONAL_ROWS]) {
    vec3 arm[SOLID_RIM], change[SOLID_RIM];
    for (int i = 0; i < SOLID_RIM; i++) {
        arm[i] = v3_sub(state->rim[section][i], centre_before);
        change[i] = v3_sub(step_of(step, section, 1 + i), step_of(step, section, 0));
    }
    vec3 turn = rotation_of(arm, change);
    for (int i = 0; i < SOLID_RIM; i++)
        state->rim[section][i] = v3_add(state->line.joints[section], turned_arm(arm[i], change[i], turn));
    return v3_norm(turn);
}

/* Applies the step with finite rotations of sections and segments. Linear displacements would stretch the needle, and Newton's method would need many more
   iterations. */
double solid_advance(const solid_model *model, const solid_tangent *tangent, const vec3 *load, solid_state *state) {
    int n = model->line.given.segments;
    double step[NEEDLE_MAX_SEGMENTS][TRIDIAGONAL_ROWS], largest = 0.0;
    solve_step(n, tangent, load, step);
    vec3 before = state->line.joints[0];
    for (int k = 1; k <= n; k++) {
        vec3 arm = v3_sub(state->line.joints[k], before), change = v3_sub(step_of(step, k, 0), step_of(step, k - 1, 0));
        vec3 turn = v3_scale(1.0 / v3_dot(arm, arm), v3_cross(arm, change));
        before = state->line.joints[k];
        state->line.joints[k] = v3_add(state->line.joints[k - 1], turned_arm(arm, change, turn));
        largest = fmax(largest, fmax(v3_norm(turn), move_rim(state, k, before, step)));
    }
    find_frames(model, state);
    return largest;
}

/* ---- moment and energy ----------------------------------------------------------------------------------------------- */

/* Computes the moment that the first layer's forces exert on the base section. */
vec3 solid_root_moment(const solid_model *model, const solid_state *state) {
    vec3 moment = v3(0, 0, 0);
    for (int t = 0; t < SOLID_LAYER_TETS; t++) {
        const layer_tet *tet = &model->solid.layers[0][t];
        strained s = strain_tet(&model->solid, tet, state, 0);
        for (int a = 0; a < 4; a++) {
            if (tet->nodes[a] >= SOLID_SECTION) continue;
            vec3 arm = v3_sub(position_of(state, 0, tet->nodes[a]), state->line.base.position);
            moment = v3_sub(moment, v3_cross(arm, nodal_force(&model->solid, tet, &s, a)));
        }
    }
    return moment;
}

double solid_energy(const solid_model *model, const solid_state *state) {
    double energy = 0.0;
    for (int k = 0; k < model->line.given.segments; k++)
        for (int t = 0; t < SOLID_LAYER_TETS; t++)
            energy += model->solid.volume * strain_tet(&model->solid, &model->solid.layers[k % 2][t], state, k).energy;
    return energy;
}

/* ---- calibration ----------------------------------------------------------------------------------------------------- */

static void set_modulus(solid_model *model, double youngs_modulus) {
    model->solid.mu = shear_modulus(youngs_modulus, model->line.given.poisson_ratio);
    model->solid.lambda = lame_lambda(youngs_modulus, model->line.given.poisson_ratio);
}

/* The compliance at the tip is proportional to 1 / E, so a single solve gives the factor on E with which it equals L^3 / (3 E I). */
static trocar_status calibrate(solid_model *model, trocar_error *why) {
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state *state = malloc(sizeof *state);
    if (tangent && state) {
        int n = model->line.given.segments;
        set_modulus(model, model->line.given.youngs_modulus);
        solid_rest(model, (pose){v3(0, 0, 0), {1, 0, 0, 0}}, state);
        solid_linearise(model, state, NULL, n, tangent);
        double wanted = pow(model->line.given.length, 3) / (3.0 * model->line.bending);
        model->solid.calibration = tangent->line.compliance[3 * n][3 * n] / wanted;
        set_modulus(model, model->solid.calibration * model->line.given.youngs_modulus);
    }
    bool done = tangent && state;
    free(tangent);
    free(state);
    return done ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "needle: no memory to calibrate the tetrahedra");
}

trocar_status solid_create(const needle_parameters *given, solid_model *model, trocar_error *why) {
    if (!(given->poisson_ratio > -1.0 && given->poisson_ratio < 0.5))
        return fail(why, TROCAR_BAD_INPUT, "needle: poisson_ratio of the tetrahedra must be above -1 and below 0.5");
    trocar_status status = needle_create(given, &model->line, why);
    if (status != TROCAR_OK) return status;
    build_mesh(model);
    return calibrate(model, why);
}
