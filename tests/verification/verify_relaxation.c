/* Tests relaxing tissue: energy balance of random insertions, and independence from tick rate and mesh. Constant displacements and removed loads are tested
   in tests/unit/insertion/test_creep.c. */
#include "figure8.h"
#include "insertion/laws/creep.h"
#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"
#include "random_hand.h"
#include "rows.h"
#include "twist.h"

static const relaxation_term SERIES[] = {{0.25, 0.15}, {0.15, 2.5}, {0.10, 30.0}};
enum { TERMS = 3, SAMPLE = 50 }; /* SAMPLE: ticks between two checks of the energy */
static const double TICK = 1e-3, STIFFENING = 2.0;

static simulation_config relaxing_config(bool relaxing) {
    simulation_config c = lockstep_config();
    c.relaxation_count = relaxing ? TERMS : 0;
    memcpy(c.relaxation, SERIES, sizeof SERIES);
    return c;
}

/* ---- energy ------------------------------------------------------------------------------------------------------------------

   A tissue that creeps is a spring in series with elements of a spring and a damper each, term k's spring being 1 / j_k times as stiff and
   bearing the force q_k that the term remembers. So it stores 1/2 f C f + sum over k of 1/2 j_k q_k C q_k, and the local compliance
   likewise. What the hand has done and the tissue and the needle do not store was dissipated: by friction, cutting, the damper at the tip,
   and creep. */

typedef struct {
    vec3 *nominal, *displaced;
} nodal;

/* Returns the energy (J) of loads on the nominal mesh. Overwrites both arguments. */
static double energy_of(lockstep *l, nodal n) {
    double sum = 0.0;
    inverse_apply(l->parts.inverse, n.nominal, n.displaced);
    for (int i = 0; i < l->parts.mesh.node_count; i++) sum += v3_dot(n.nominal[i], n.displaced[i]);
    return 0.5 * sum;
}

static void spread(const mesh *m, int tet, const double weights[4], vec3 force, vec3 *nominal) {
    for (int c = 0; c < 4; c++) nominal[m->tets[tet][c]] = v3_axpy(weights[c], force, nominal[m->tets[tet][c]]);
}

/* Adds the needle's forces (term -1), or those a relaxation term remembers. */
static void put_loads(const lockstep *l, int term, vec3 *nominal) {
    const insertion_state *s = &l->state;
    const mesh *m = &l->parts.mesh;
    memset(nominal, 0, (size_t)m->node_count * sizeof *nominal);
    for (int k = 0; contact_is_active(s, k); k++) { /* compliance_between covers contacts on the nominal mesh */
        const added_node *node = &s->refined.nodes[s->refined.order[k]];
        double weights[4];
        mesh_barycentric(m, node->tet, node->position, weights);
        spread(m, node->tet, weights, term < 0 ? s->contacts[s->refined.order[k]].force : k < s->memory.count ? s->memory.shares[k].terms[term].load : v3(0, 0, 0), nominal);
    }
    if (s->tip.place.phase == TIP_INSIDE && s->tip.known.tet >= 0)
        spread(m, s->tip.known.tet, s->tip.known.weights, term < 0 ? tip_load(&s->tip) : s->memory.tip ? s->memory.shares[s->memory.count - 1].terms[term].load : v3(0, 0, 0), nominal);
    for (int i = 0; i < s->memory.residual.count && term >= 0; i++) spread(m, s->memory.residual.loads[i].tet, s->memory.residual.loads[i].weights, s->memory.residual.loads[i].load[term], nominal);
}

/* Returns the fraction of the tip's force carried by the shaft. The rest acts one radius ahead of the tip. */
static double shaft_part(const lockstep *l, const contact_point *p) {
    double length = p->share.to - p->share.from, radius = l->parts.needle.radius;
    return p->kind == POINT_TIP ? length / (length + radius) : 1.0;
}

/* Near the surface, the tissue under the end face becomes softer the harder the face presses (local_at_tip). A force F on it stores the integral of F over
   the displacement, which exceeds 1/2 F times the displacement by the value returned. */
static double softening_energy(const lockstep *l, double face) {
    const needle_tip *tip = &l->state.tip;
    enum { STEPS = 20 };
    double depth = tip->place.depth - tip_entry_depth(&l->state), sum = 0.0, step = fmax(face, 0.0) / STEPS, point = tip->resolution.field.point;
    double now = local_at_tip(&l->parts.insertion, tip->place.tet, tip->place.nominal, depth, fmax(face, 0.0), point);
    for (double force = 0.5 * step; force < face; force += step)
        sum += step * force * (now - local_at_tip(&l->parts.insertion, tip->place.tet, tip->place.nominal, depth, force, point));
    return sum;
}

/* Returns the needle's force (N) on the tissue around the shaft at a point. At the tip, the end face carries the rest. */
static vec3 force_around_shaft(const lockstep *l, int i) {
    const insertion_workspace *w = l->run.workspace;
    vec3 force = point_force(&l->state, &w->points.list[i]), needle = needle_along(&w->points.list[i].at);
    if (w->points.list[i].kind != POINT_TIP) return force;
    vec3 aside = v3_axpy(-v3_dot(force, needle), needle, force);
    return v3_axpy(w->problem.force[2 * w->problem.count + i + 1], needle, v3_scale(w->tissue.sideways_on_shaft, aside));
}

/* Returns the energy (J) of the local compliances under forces across and along the needle. Term -1 stands for the needle's forces. */
static double local_energy(const lockstep *l, int term) {
    const insertion_workspace *w = l->run.workspace;
    const tissue_memory *memory = &l->state.memory;
    double sum = 0.0, softening = 0.0;
    for (int i = w->points.guided; i < w->points.count && (term < 0 || i - w->points.guided < memory->count); i++) {
        bool tip = w->points.list[i].kind == POINT_TIP;
        const share_memory *share = &memory->shares[i - w->points.guided];
        vec3 track = point_track(&l->state, &w->points.list[i]), needle = needle_along(&w->points.list[i].at);
        vec3 force = term < 0 ? point_force(&l->state, &w->points.list[i]) : share->terms[term].load;
        vec3 aside = v3_axpy(-v3_dot(force, needle), needle, force), on_shaft = force_around_shaft(l, i);
        double along = v3_dot(on_shaft, track);
        vec3 across = v3_axpy(-along, track, on_shaft), face = v3_sub(force, on_shaft);
        if (term < 0) {
            sum += w->creep.yield * w->tissue.extra_lateral_compliance[i] * v3_dot(aside, aside);
            if (tip) softening = softening_energy(l, v3_dot(face, track));
        } else {
            vec3 whole = v3_axpy(-v3_dot(force, track), track, force);
            along = shaft_part(l, &w->points.list[i]) * share->terms[term].along;
            across = tip ? v3_scale(w->tissue.sideways_on_shaft, whole) : whole;
            if (tip) face = v3_axpy(memory->face[term], track, v3_scale(1.0 - w->tissue.sideways_on_shaft, whole));
        }
        double easily = v3_dot(across, w->tissue.lateral[i].easy);
        sum += w->tissue.lateral[i].least * v3_dot(across, across) + w->tissue.lateral[i].more * easily * easily + w->tissue.axial[i + tip] * along * along;
        if (tip) sum += w->tissue.axial[i] * v3_dot(face, face);
    }
    return 0.5 * sum / w->creep.yield + softening;
}

/* Returns the energy (J) of the tissue rotated by the shaft, under the torques a term remembers. */
static double twist_energy(const lockstep *l, int term) {
    const insertion_workspace *w = l->run.workspace;
    double sum = 0.0;
    for (int i = w->points.guided; i < w->points.count; i++) {
        const share_memory *share = &l->state.memory.shares[i - w->points.guided];
        sum += twist_yielding(l, &w->points.list[i]) * pow(shaft_part(l, &w->points.list[i]) * share->terms[term].twist, 2);
    }
    return 0.5 * sum;
}

/* Returns the energy (J) a stiffening spring stores beyond that of a linear one, i.e. the integral of the force over the additional displacement. */
static double stiffening_energy(const stiffening_law *law, double force) {
    double energy = force * stiffening_at(law, force).shift;
    for (int i = 0; i < 100; i++) energy -= stiffening_at(law, force * (i + 0.5) / 100).shift * force / 100;
    return energy;
}

/* Returns this additional energy, summed over all local compliances of elastic tissue. */
static double stiffened_energy(const lockstep *l) {
    const insertion_workspace *w = l->run.workspace;
    const stiffening_step *s = &w->stiffening;
    double sum = 0.0;
    if (!l->parts.insertion.stiffens) return 0.0;
    for (int i = w->points.guided; i < w->points.count; i++) {
        bool tip = w->points.list[i].kind == POINT_TIP;
        vec3 track = point_track(&l->state, &w->points.list[i]);
        double along = v3_dot(track, point_force(&l->state, &w->points.list[i])), shaft = v3_dot(track, force_around_shaft(l, i));
        sum += stiffening_energy(&s->along[i], shaft);
        if (tip) sum += stiffening_energy(&s->face, along - shaft + v3_dot(l->state.tip.dent.damping, track));
    }
    return sum;
}

static double stored(lockstep *l, nodal n) {
    const creep_series *creep = &l->parts.insertion.creep;
    double sum = needle_energy(&l->parts.needle, &l->state.needle) + twist_energy_of_needle(l) + twist_energy_of_tissue(l) + stiffened_energy(l);
    for (int term = -1; term < creep->count; term++) {
        double factor = term < 0 ? 1.0 : creep->compliance[term];
        put_loads(l, term, n.nominal);
        sum += factor * (energy_of(l, n) + local_energy(l, term));
        if (term >= 0) sum += factor * twist_energy(l, term);
    }
    return sum;
}

typedef struct {
    double most_work;        /* J */
    double least;            /* J, smallest dissipation between two checks */
    double dissipated;       /* J, total dissipation */
} energy_record;

static lockstep *create_tissue(bool relaxing, double stiffening) {
    simulation_config c = relaxing_config(relaxing);
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.stiffening = stiffening;
    return lockstep_create(&c, lockstep_start());
}

/* Inserts into tissue that has no tracks and remembers no loads. */
static energy_record insert(lockstep *l, unsigned seed) {
    random_hand hand = random_hand_brief(seed);
    l->parts.needle.given.bevel_slope = hand.bevel_slope;
    insertion_reset(&l->parts.insertion, hand.start, &l->state);
    l->base = hand.start;
    l->wrench = (tick_output){.membrane = -1};
    size_t nodes = (size_t)l->parts.mesh.node_count;
    nodal n = {calloc(nodes, sizeof(vec3)), calloc(nodes, sizeof(vec3))};
    energy_record r = {.least = INFINITY};
    double work = 0.0;
    int ticks = 0;
    for (int k = 0; k < hand.leg_count; k++) {
        pose from = l->base;
        for (int i = 1; i <= (int)(hand.legs[k].seconds / TICK); i++) {
            pose before = l->base;
            tick_output then = l->wrench;
            lockstep_tick(l, hand_pose(&hand.legs[k], from, NEEDLE_LENGTH - l->wrench.depth, i * TICK), TICK);
            vec3 shift = v3_sub(l->base.position, before.position), turn = q_log(q_multiply(l->base.orientation, q_conjugate(before.orientation)));
            work -= 0.5 * (v3_dot(v3_add(then.force, l->wrench.force), shift) + v3_dot(v3_add(then.torque, l->wrench.torque), turn));
            if (++ticks % SAMPLE != 0) continue;
            double lost = work - stored(l, n);
            r.least = fmin(r.least, lost - r.dissipated);
            r.dissipated = lost;
            r.most_work = fmax(r.most_work, work);
        }
    }
    free(n.nominal), free(n.displaced);
    return r;
}

static void check_energy_of_stiffening(rows *r) {
    char check[160];
    double worst = INFINITY;
    int count = r->short_form ? 1 : 50;
    lockstep *l = create_tissue(false, STIFFENING);
    for (int i = 0; i < count; i++) {
        energy_record e = insert(l, (unsigned)i + 1);
        worst = fmin(worst, e.least / e.most_work);
    }
    lockstep_free(l);
    snprintf(check, sizeof check, "elastic tissue that stiffens, S = %g, %d random insertion%s: smallest dissipation in 50 ms", STIFFENING, count, count > 1 ? "s" : "");
    rows_add(r, (row){.check = check, .reference = "not negative", .value = worst, .expected = NAN, .error = fmax(0.0, -worst), .limit = 0.01,
                      .note = "relative to the largest work of the hand"});
}

static void check_energy(rows *r) {
    enum { INSERTIONS = 200, ELASTIC = 20, OF_SHORT_FORM = 36 }; /* the short form runs every 36th of them */
    double worst[2] = {INFINITY, INFINITY};
    int count[2] = {0};
    char check[160];
    for (int relaxing = r->short_form; relaxing < 2; relaxing++) {
        lockstep *l = create_tissue(relaxing, 0.0);
        for (int i = 0; i < (relaxing ? INSERTIONS : ELASTIC); i++) {
            if (r->short_form && i % OF_SHORT_FORM != 1) continue;
            energy_record e = insert(l, (unsigned)i + 1);
            worst[relaxing] = fmin(worst[relaxing], e.least / e.most_work);
            count[relaxing]++;
        }
        lockstep_free(l);
    }
    for (int relaxing = 1; relaxing >= 0 && count[relaxing] > 0; relaxing--) {
        snprintf(check, sizeof check, "%d random insertions%s: smallest dissipation in 50 ms", count[relaxing], relaxing ? "" : " into elastic tissue");
        row dissipated = {.check = check, .reference = "not negative", .value = worst[relaxing], .expected = NAN, .error = fmax(0.0, -worst[relaxing]), .limit = 1e-6,
                          .note = "relative to the largest work of the hand"};
        if (relaxing) rows_add(r, dissipated);
        else rows_measured(r, dissipated);
    }
    check_energy_of_stiffening(r);
}

/* Shakes a sticking needle, so that only creep dissipates energy. Computed with the forces at the end of each tick, the dissipation must not be negative in
   any tick. */
static void check_shaken(rows *r) {
    simulation_config c = relaxing_config(true);
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->cutting_force = m->friction_static = m->friction_kinetic = 1e4;
    }
    lockstep *l = lockstep_engaged(&c);
    size_t nodes = (size_t)l->parts.mesh.node_count;
    nodal n = {calloc(nodes, sizeof(vec3)), calloc(nodes, sizeof(vec3))};
    energy_record e = {.least = INFINITY};
    double work = 0.0;
    pose start = l->base;
    for (int i = 1; i <= 400; i++) {
        double t = i * TICK;
        pose before = l->base;
        vec3 way = v3(1e-3 * sin(21.0 * t), 0.7e-3 * sin(33.0 * t), 0.3e-3 * sin(27.0 * t));
        lockstep_tick(l, (pose){v3_add(start.position, way), start.orientation}, TICK);
        work -= v3_dot(l->wrench.force, v3_sub(l->base.position, before.position));
        double lost = work - stored(l, n);
        e.least = fmin(e.least, lost - e.dissipated);
        e.dissipated = lost;
        e.most_work = fmax(e.most_work, work);
    }
    rows_add(r, (row){.check = "stuck needle shaken: smallest dissipation in a tick", .reference = "not negative", .value = e.least / e.most_work, .expected = NAN,
                      .error = fmax(0.0, -e.least / e.most_work), .limit = 1e-6, .note = "relative to the largest work of the hand"});
    free(n.nominal), free(n.displaced);
    lockstep_free(l);
}

/* ---- tick rate and mesh ------------------------------------------------------------------------------------------------------ */

static void check_rates(rows *r) {
    simulation_config c = relaxing_config(true);
    figure8_record *reference = figure8_run(&c, 4000, 1);
    for (double rate = 250; rate < 4000; rate *= 2) {
        if (r->short_form && rate != 250) continue;
        char check[96];
        figure8_record *run = figure8_run(&c, rate, 1);
        snprintf(check, sizeof check, "figure 8 at %g Hz: force", rate);
        rows_error(r, check, "4 kHz, over the peak", figure8_difference(run, reference, 0, 3, FIGURE8_SLOWEST_PERIOD), 0.01);
        free(run);
    }
    free(reference);
}

/* Forces along the needle and sideways after an insertion and a push, and what is left of them after holding. */
typedef struct { double along, sideways, along_held, sideways_held; } held_forces;

static held_forces push_and_hold(const char *path) {
    simulation_config c = relaxing_config(true);
    snprintf(c.mesh_path, sizeof c.mesh_path, "%s", path);
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.066), 1.5, TICK);
    double along = -l->wrench.force.z;
    lockstep_move(l, v3(0, 0, 0), 1.0, TICK);
    double along_held = -l->wrench.force.z;
    lockstep_move(l, v3(0.005, 0, 0), 0.2, TICK);
    double sideways = -l->wrench.force.x;
    lockstep_move(l, v3(0, 0, 0), 1.0, TICK);
    held_forces f = {along, sideways, along_held, -l->wrench.force.x};
    lockstep_free(l);
    return f;
}

static void check_meshes(rows *r) {
    held_forces first = push_and_hold(MESHES "/prostate-570.msh"), other = push_and_hold(MESHES "/prostate.msh");
    rows_compare(r, "pushed in 66 mm, then held for 1 s: what is left of the force", "another mesh of the body, 588 nodes", first.along_held / first.along, other.along_held / other.along, 0.02, NULL);
    rows_compare(r, "pushed sideways, then held for 1 s: what is left of the force", "another mesh of the body, 588 nodes", first.sideways_held / first.sideways, other.sideways_held / other.sideways, 0.02, NULL);
    rows_compare(r, "pushed sideways: force", "another mesh of the body, 588 nodes", first.sideways, other.sideways, 0.07, "N");
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Relaxation: energy, independence of rate and mesh");
    check_energy(&r);
    check_shaken(&r);
    check_rates(&r);
    check_meshes(&r);
    return rows_end(&r);
}
