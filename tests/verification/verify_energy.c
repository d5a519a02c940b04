/* Energy balance of whole insertions: the work of the hand is stored (tissue, local compliance, needle) or dissipated.

   Between two ticks, with the mean f of a point's forces before and after:
   - the shaft slides past a contact node by the slip of the later solve: friction takes f.t slip;
   - the tip's nominal point moves by dX and its axial gap by dg: cutting and puncture take f.(dX + dg t);
   - the shaft next to the tip bears a force of its own at the tip's point: friction takes it as at a contact node;
   - the points of the tissue move by du and the local compliances stretch by de: of the work f.(du + de), what is not stored
     is lost because the compliance itself has changed, 1/2 f dC f: the tip feels another part of the tissue, or lengths of
     shaft are shared out anew. Like the energy release rate of a crack, this part belongs to cutting.
   Displacements and the energy stored in the tissue come from a solve with the whole K, not from the tick's condensed rows. */
#include "lockstep.h"
#include "rows.h"

enum { POINTS = MAX_CONTACTS + 2 };
static const uint64_t TIP = UINT64_MAX, TIP_SHAFT = UINT64_MAX - 1;

/* One force on the tissue. */
typedef struct {
    uint64_t id;             /* of the contact node, TIP or TIP_SHAFT */
    int tet;                 /* nominal element */
    vec3 nominal;            /* m */
    vec3 force;              /* N */
    vec3 moved;              /* m, displacement of the tissue and stretch of the local compliance */
    vec3 tangent;            /* of the needle there */
    double slip;             /* m, of the last solve */
} point;

/* The state after a tick. */
typedef struct {
    int count;
    point points[POINTS];
    refinement refined;
    vec3 *nominal, added[POINTS]; /* m, displacement of the nodes */
    double tissue, local, needle; /* J, stored */
    pose base;
    vec3 force, torque;      /* of the base on the hand */
} picture;

typedef struct { double work, friction, cutting, configuration; } energies; /* J, so far */

static void add_local(picture *s, point *p, double lateral, double axial) {
    double along = v3_dot(p->force, p->tangent);
    vec3 across = v3_axpy(-along, p->tangent, p->force);
    p->moved = v3_axpy(lateral, across, v3_axpy(axial * along, p->tangent, p->moved));
    s->local += 0.5 * (lateral * v3_dot(across, across) + axial * along * along);
}

/* Displacement at a nominal point in this state: of the refined mesh; of the nominal one under the tip, where its force acts. */
static vec3 displacement_at(const mesh *m, const picture *s, const point *p) {
    leaf_point leaf = refinement_locate(m, &s->refined, p->id >= TIP_SHAFT ? 0 : s->refined.count, p->tet, p->nominal);
    vec3 u = v3(0, 0, 0);
    for (int c = 0; c < 4; c++) u = v3_axpy(leaf.weights[c], leaf.corners[c] >= 0 ? s->nominal[leaf.corners[c]] : s->added[-1 - leaf.corners[c]], u);
    return u;
}

static void take_picture(lockstep *l, picture *s) {
    const insertion_workspace *w = l->simulation.workspace;
    bool tip = l->state.tip.phase == TIP_INSIDE && w->problem.count == l->state.active + 1 && !(l->wrench.events & EVENT_TOUCHED);
    insertion_refinement(&l->state, &s->refined);
    simulation_displacement(&l->simulation, &l->state, s->nominal, s->added);
    s->count = l->state.active + 2 * tip;
    s->tissue = s->local = 0.0;
    for (int i = 0; i < s->count; i++) {
        bool at_tip = i >= l->state.active;
        int at = i < l->state.active ? i : l->state.active;
        const added_node *node = &s->refined.nodes[at];
        point *p = &s->points[i];
        *p = at_tip ? (point){.id = i == at ? TIP : TIP_SHAFT, .tet = l->state.tip.tet, .nominal = l->state.tip.nominal}
                    : (point){.id = node->id, .tet = node->tet, .nominal = node->position, .force = l->state.contacts[i].force};
        p->slip = w->problem.slip[i];
        p->tangent = v3(w->points[at].frame.m[0][2], w->points[at].frame.m[1][2], w->points[at].frame.m[2][2]);
        if (at_tip) {
            vec3 friction = v3_scale(w->problem.force[2 * w->problem.count + l->state.active + 1], p->tangent);
            p->force = i == at ? v3_sub(l->state.tip.force, friction) : friction;
        }
        p->moved = displacement_at(&l->simulation.mesh, s, p);
        s->tissue += 0.5 * v3_dot(p->force, p->moved);
        add_local(s, p, i == at ? w->lateral[at] : 0.0, w->axial[i]);
    }
    s->needle = needle_energy(&l->simulation.needle, &l->state.needle);
    s->base = l->base;
    s->force = l->wrench.force;
    s->torque = l->wrench.torque;
}

/* The same point in another state; without force where it takes no part there. */
static point find(const mesh *m, const picture *s, const point *p) {
    for (int i = 0; i < s->count; i++)
        if (s->points[i].id == p->id) return s->points[i];
    point absent = *p;
    absent.force = v3(0, 0, 0);
    absent.slip = 0.0;
    absent.moved = displacement_at(m, s, p);
    return absent;
}

static void add_point(const point *before, const point *after, energies *e) {
    vec3 mean = v3_scale(0.5, v3_add(before->force, after->force));
    double along = v3_dot(mean, after->tangent);
    e->configuration += v3_dot(mean, v3_sub(after->moved, before->moved));
    if (after->id == TIP) e->cutting += v3_dot(mean, v3_sub(after->nominal, before->nominal)) + along * (after->slip - before->slip);
    else e->friction += along * after->slip;
}

static void add_tick(const mesh *m, const picture *before, const picture *after, energies *e) {
    vec3 shift = v3_sub(after->base.position, before->base.position);
    vec3 turn = q_log(q_multiply(after->base.orientation, q_conjugate(before->base.orientation)));
    e->work -= 0.5 * (v3_dot(v3_add(before->force, after->force), shift) + v3_dot(v3_add(before->torque, after->torque), turn));
    for (int i = 0; i < after->count; i++) {
        point then = find(m, before, &after->points[i]);
        add_point(&then, &after->points[i], e);
    }
    for (int i = 0; i < before->count; i++) {
        point now = find(m, after, &before->points[i]);
        bool stays = false;
        for (int k = 0; k < after->count; k++) stays = stays || after->points[k].id == before->points[i].id;
        if (!stays) add_point(&before->points[i], &now, e);
    }
    e->configuration -= after->tissue + after->local - before->tissue - before->local;
}

/* ---- insertions --------------------------------------------------------------------------------------------------------------- */

typedef struct { double seconds; vec3 shift, turn; } leg;
static const leg straight[] = {{1.0, {0, 0, 0.071}, {0, 0, 0}}, {1.0, {0, 0, -0.075}, {0, 0, 0}}};
static const leg steered[] = {{0.6, {0, 0, 0.051}, {0, 0, 0}}, {0.2, {0.001, 0.004, 0}, {0.01, 0, 0.5}}, {0.3, {0, 0, 0.02}, {0, 0, 1.0}},
                              {0.3, {0, 0, -0.03}, {0, 0, 0}}, {0.3, {0, -0.003, 0.02}, {0, 0, 0}}, {1.0, {-0.001, -0.001, -0.066}, {0, 0, 0}}};

typedef struct {
    energies total;
    double most_work;        /* J, peak */
    double worst;            /* J, largest imbalance on the way */
    double least_friction;   /* J, most negative step of what friction took */
    int count;
    double time[4000], work[4000], stored[4000], dissipated[4000];
} balance;

static double stored(const picture *s) { return s->tissue + s->local + s->needle; }

static void follow(balance *b, const picture *now, double time) {
    const energies *e = &b->total;
    double lost = e->friction + e->cutting + e->configuration;
    b->worst = fmax(b->worst, fabs(e->work - stored(now) - lost));
    b->most_work = fmax(b->most_work, e->work);
    if (b->count == 4000) return;
    b->time[b->count] = time, b->work[b->count] = 1e3 * e->work, b->stored[b->count] = 1e3 * stored(now), b->dissipated[b->count++] = 1e3 * lost;
}

static balance *run(const leg *legs, int leg_count, double tick, bool bevelled) {
    simulation_config c = lockstep_config();
    c.needle.bevel_slope = bevelled ? 0.05 : 0.0;
    lockstep *l = lockstep_create(&c, lockstep_start());
    balance *b = calloc(1, sizeof *b);
    picture *before = calloc(1, sizeof *before), *after = calloc(1, sizeof *after);
    before->nominal = calloc((size_t)l->simulation.mesh.node_count, sizeof(vec3));
    after->nominal = calloc((size_t)l->simulation.mesh.node_count, sizeof(vec3));
    take_picture(l, before);
    double time = 0.0;
    for (int k = 0; k < leg_count; k++) {
        int n = (int)(legs[k].seconds / tick + 0.5);
        pose from = l->base;
        for (int i = 1; i <= n; i++) {
            double part = (double)i / n;
            lockstep_tick(l, (pose){v3_axpy(part, legs[k].shift, from.position), q_multiply(from.orientation, q_exp(v3_scale(part, legs[k].turn)))}, tick);
            take_picture(l, after);
            double friction = b->total.friction;
            add_tick(&l->simulation.mesh, before, after, &b->total);
            b->least_friction = fmin(b->least_friction, b->total.friction - friction);
            follow(b, after, time += tick);
            picture *swap = before;
            before = after, after = swap;
        }
    }
    free(before->nominal), free(after->nominal), free(before), free(after);
    lockstep_free(l);
    return b;
}

static void draw(rows *r, const char *figure, const balance *b) {
    curve c = {.figure = figure, .x_label = "time (s)", .y_label = "energy (mJ)", .count = b->count, .x = b->time};
    c.label = "work of the hand", c.y = b->work;
    rows_curve(r, c);
    c.label = "stored", c.y = b->stored;
    rows_curve(r, c);
    c.label = "dissipated", c.y = b->dissipated;
    rows_curve(r, c);
}

static void check(rows *r, const char *name, const char *figure, const leg *legs, int leg_count, bool bevelled) {
    double ticks[4], off[4];
    char text[160], note[200];
    int finest = r->short_form ? 1 : 4;
    for (int i = 0; i < finest; i++) {
        ticks[i] = 1e-3 / (1 << i);
        balance *b = run(legs, leg_count, ticks[i], bevelled);
        const energies *e = &b->total;
        double lost = e->friction + e->cutting + e->configuration;
        off[i] = fabs(e->work - lost) / b->most_work;
        snprintf(text, sizeof text, "%s, %g Hz: work against what was dissipated", name, 1.0 / ticks[i]);
        snprintf(note, sizeof note, "friction %.2f mJ, cutting %.2f, changing compliance %.2f; over the greatest work; worst on the way %.2g",
                 1e3 * e->friction, 1e3 * e->cutting, 1e3 * e->configuration, b->worst / b->most_work);
        rows_add(r, (row){.check = text, .reference = "sum over slips, cuts and compliance", .value = e->work, .expected = lost, .error = off[i],
                          .limit = 0.01, .unit = "J", .note = note});
        if (i == 0) {
            draw(r, figure, b);
            snprintf(text, sizeof text, "%s: least that friction took in a tick", name);
            rows_add(r, (row){.check = text, .reference = "not negative", .value = b->least_friction, .expected = NAN,
                              .error = -b->least_friction / b->most_work, .limit = 1e-6, .unit = "J", .note = "error over the greatest work"});
        }
        free(b);
    }
    rows_curve(r, (curve){.figure = "energy-convergence", .label = name, .x_label = "tick (s)", .y_label = "imbalance over the greatest work",
                          .logarithmic = true, .count = finest, .x = ticks, .y = off});
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: energy balance");
    check(&r, "straight in 70 mm and out", "energy-straight", straight, sizeof straight / sizeof *straight, false);
    check(&r, "steered, with a bevel, in, about and out", "energy-steered", steered, sizeof steered / sizeof *steered, true);
    return rows_end(&r);
}
