/* Checks the energy balance of complete insertions: the hand's work is either stored (in tissue, local compliances and needle) or dissipated.

   Between two ticks, with f the mean of a point's forces before and after:
   - the shaft slides past a contact node by the slip of the later solve: friction dissipates f.t slip;
   - the tip's nominal point moves by dX and its axial gap by dg: cutting and puncture dissipate f.(dX + dg t);
   - the shaft next to the tip has its own force at the tip's point: friction dissipates as at a contact node;
   - the tip moves to a position where the tissue is more or less compliant: from the surface to the inside, from soft to stiff tissue. At given forces, this
     alone releases or stores the energy 1/2 f dC f, where C is the compliance at the tip, like a crack's energy release rate; the tissue springs back and
     reduces the work of cutting. This energy is computed by another solve, with the forces after the tick and the tip at its position before it.
   - the shaft turns in the tissue by the angle of the later solve: friction dissipates the torque times it;
   - the damper at the tip, which keeps the tissue from springing back faster than waves propagate, dissipates its force times the motion of the tissue there.
   These are all the physical terms. The rest of the imbalance is due to the method:
   - contact nodes are added and removed and tributary lengths change, so that local compliances change under load. This part is computed as the work f.(du +
     de) on tissue (du) and local compliances (de), plus the work of the torques on the tissue around the shaft, minus the energy that they store and that the
     tip releases.
   Displacements and the energy stored in the tissue come from a solve with the full K, not from the tick's condensed rows. */
#include "lockstep.h"
#include "rows.h"
#include "twist.h"

enum { POINTS = MAX_CONTACTS + 2 };
static const uint64_t TIP = UINT64_MAX, TIP_SHAFT = UINT64_MAX - 1;

/* One force on the tissue. */
typedef struct {
    uint64_t id;             /* of the contact node, or TIP or TIP_SHAFT */
    int tet;                 /* nominal element */
    vec3 nominal;            /* m */
    vec3 force;              /* N, needle on tissue */
    vec3 damping;            /* N, damper at the tip on tissue */
    vec3 moved;              /* m, displacement of the tissue plus that of the local compliance */
    vec3 tangent;            /* of the needle at the point */
    double slip;             /* m, in the last solve */
    double torque;           /* N m, shaft on the tissue around it */
    double twisted;          /* rad, how far the shaft has rotated that tissue */
    double turned;           /* rad, how far the shaft slid around its axis in the last solve */
    double end;              /* m/N, local compliance under the tip's end face; 0 for points other than the tip */
} point;

/* The state after a tick. */
typedef struct {
    int count;
    point points[POINTS];
    refinement refined;
    vec3 *nominal, added[POINTS]; /* m, displacement of the nodes */
    int tip_tet;             /* nominal element in which the tip's force acts, or -1 for none, and the weights of its corners */
    double tip_weights[4];
    double tissue, local, needle; /* J, stored */
    pose base;
    vec3 force, torque;      /* that the base exerts on the hand */
} picture;

typedef struct {
    double work, friction, cutting; /* J so far; work: by the hand; friction and cutting (including punctures): dissipated */
    double damping;          /* J, dissipated by the damper at the tip */
    double freed;            /* J, stored in the tissue as the tip advances; negative if released */
    double handed;           /* J, lost when contact nodes and tributary lengths change */
} energies;                  /* J, so far */

static picture *picture_create(const lockstep *l) {
    picture *s = calloc(1, sizeof *s);
    s->nominal = calloc((size_t)l->parts.mesh.node_count, sizeof(vec3));
    return s;
}

static void picture_free(picture *s) {
    free(s->nominal);
    free(s);
}

/* Returns the total force on the tissue at a point. */
static vec3 load_at(const point *p) { return v3_add(p->force, p->damping); }

/* Adds the displacement and the energy of a point's local compliance. Around a shaft, the compliance across the track differs from that along it; at the end
   face, it is the same in every direction. */
static void add_local(picture *s, point *p, vec3 track, principal_tensor lateral, double axial) {
    vec3 load = load_at(p), across = v3_axpy(-v3_dot(load, track), track, load), moved = v3_scale(axial * v3_dot(load, track), track);
    moved = v3_axpy(lateral.least, across, v3_axpy(lateral.more * v3_dot(load, lateral.easy), lateral.easy, moved));
    if (p->id == TIP) moved = v3_scale(axial, load);
    p->moved = v3_add(p->moved, moved);
    s->local += 0.5 * v3_dot(load, moved);
}

/* The part of the shaft assigned to the tip turns with TIP_SHAFT. */
static void add_twist(const lockstep *l, picture *s, point *p, const contact_point *at) {
    const roll_friction *roll = twist_at(l, at);
    p->torque = roll->torque;
    p->twisted = twist_yielding(l, at) * roll->torque;
    p->turned = roll->turned;
    s->local += 0.5 * p->torque * p->twisted;
}

/* Returns the displacement of the nominal mesh at a point in this state. */
static vec3 displacement_at(const mesh *m, const picture *s, const point *p) {
    double weights[4];
    vec3 u = v3(0, 0, 0);
    mesh_barycentric(m, p->tet, p->nominal, weights);
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], s->nominal[m->tets[p->tet][c]], u);
    return u;
}

static void take_picture(lockstep *l, picture *s) {
    const insertion_workspace *w = l->run.workspace;
    const needle_tip *end = &l->state.tip;
    bool tip = end->place.phase == TIP_INSIDE && w->problem.count == contacts_active(&l->state) + 1 && !(l->wrench.events & EVENT_TOUCHED);
    insertion_refinement(&l->state, &s->refined);
    run_displacement(&l->run, &l->state, s->nominal, s->added);
    s->count = contacts_active(&l->state) + 2 * tip;
    s->tip_tet = tip ? end->known.tet : -1;
    memcpy(s->tip_weights, end->known.weights, sizeof s->tip_weights);
    s->tissue = s->local = 0.0;
    for (int i = 0; i < s->count; i++) {
        bool at_tip = i >= contacts_active(&l->state);
        int at = i < contacts_active(&l->state) ? i : contacts_active(&l->state);
        const added_node *node = &s->refined.nodes[at];
        point *p = &s->points[i];
        *p = at_tip ? (point){.id = i == at ? TIP : TIP_SHAFT, .tet = end->place.tet, .nominal = end->place.nominal, .end = i == at ? w->tissue.axial[at] : 0.0}
                    : (point){.id = node->id, .tet = node->tet, .nominal = node->position, .force = l->state.contacts[i].force};
        p->slip = w->problem.slip[i];
        p->tangent = needle_along(&w->points.list[at].at);
        if (at_tip) {
            vec3 sideways = v3_axpy(-v3_dot(end->solved.force, p->tangent), p->tangent, end->solved.force);
            vec3 shaft = v3_axpy(w->problem.force[2 * w->problem.count + contacts_active(&l->state) + 1], p->tangent, v3_scale(w->tissue.sideways_on_shaft, sideways));
            p->force = i == at ? v3_sub(end->solved.force, shaft) : shaft;
            if (i == at) p->damping = end->dent.damping;
        }
        p->moved = displacement_at(&l->parts.mesh, s, p);
        s->tissue += 0.5 * v3_dot(load_at(p), p->moved);
        add_local(s, p, point_track(&l->state, &w->points.list[at]), w->tissue.lateral[at], w->tissue.axial[i]);
        if (p->id != TIP) add_twist(l, s, p, &w->points.list[at]);
    }
    s->needle = needle_energy(&l->parts.needle, &l->state.needle) + twist_energy_of_needle(l);
    s->base = l->base;
    s->force = l->wrench.force;
    s->torque = l->wrench.torque;
}

/* Returns the same point in another state, with zero force if it is not active there. */
static point find(const mesh *m, const picture *s, const point *p) {
    for (int i = 0; i < s->count; i++)
        if (s->points[i].id == p->id) return s->points[i];
    point absent = *p;
    absent.force = absent.damping = v3(0, 0, 0);
    absent.slip = absent.torque = absent.twisted = absent.turned = 0.0;
    absent.moved = displacement_at(m, s, p);
    return absent;
}

static void add_point(const point *before, const point *after, energies *e) {
    vec3 mean = v3_scale(0.5, v3_add(before->force, after->force)), moved = v3_sub(after->moved, before->moved);
    double damped = -0.5 * v3_dot(v3_add(before->damping, after->damping), moved);
    double along = v3_dot(mean, after->tangent);
    double torque = 0.5 * (before->torque + after->torque);
    e->damping += damped;
    e->handed += v3_dot(mean, moved) - damped + torque * (after->twisted - before->twisted);
    e->friction += torque * after->turned;
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
    e->handed -= after->tissue + after->local - before->tissue - before->local;
}

/* Returns the energy (J) stored in the tissue as the tip advances: 1/2 f dC f, summed over all forces before and after the tick. `stayed` has the forces
   after the tick with the tip where it was before. */
static double bound_by_tip(lockstep *l, const picture *before, const picture *after, picture *stayed) {
    if (before->tip_tet < 0 || after->tip_tet < 0) return 0.0;
    insertion_state state = l->state;
    state.tip.known.tet = before->tip_tet;
    memcpy(state.tip.known.weights, before->tip_weights, sizeof before->tip_weights);
    run_displacement(&l->run, &state, stayed->nominal, stayed->added);
    stayed->refined = after->refined;
    const mesh *m = &l->parts.mesh;
    double sum = 0.0;
    for (int i = 0; i < after->count; i++) {
        const point *now = &after->points[i];
        point then = find(m, before, now);
        vec3 shift = v3_sub(displacement_at(m, after, now), displacement_at(m, stayed, &then));
        sum += 0.5 * (v3_dot(load_at(&then), shift) + (now->end - then.end) * v3_dot(load_at(&then), then.tangent) * v3_dot(load_at(now), now->tangent));
    }
    return sum;
}

/* ---- insertions --------------------------------------------------------------------------------------------------------------- */

typedef struct { double seconds; vec3 shift, turn; } leg;
static const leg straight[] = {{1.0, {0, 0, 0.071}, {0, 0, 0}}, {1.0, {0, 0, -0.075}, {0, 0, 0}}};
static const leg steered[] = {{0.6, {0, 0, 0.051}, {0, 0, 0}}, {0.2, {0.001, 0.004, 0}, {0.01, 0, 0.5}}, {0.3, {0, 0, 0.02}, {0, 0, 1.0}},
                              {0.3, {0, 0, -0.03}, {0, 0, 0}}, {0.3, {0, -0.003, 0.02}, {0, 0, 0}}, {1.0, {-0.001, -0.001, -0.066}, {0, 0, 0}}};

/* Turns the needle back and forth at rest, while it is inserted, and while it is withdrawn. */
static const leg turned[] = {{0.4, {0, 0, 0.041}, {0, 0, 0}}, {0.3, {0, 0, 0}, {0, 0, 3.0}}, {0.3, {0, 0, 0}, {0, 0, -3.0}}, {0.3, {0, 0, 0.025}, {0, 0, 3.0}},
                             {0.2, {0, 0, 0}, {0, 0, -2.0}}, {0.5, {0, 0, -0.03}, {0, 0, -3.0}}, {0.4, {0, 0, -0.04}, {0, 0, 0}}};

typedef struct {
    energies total;
    double most_work;        /* J, peak */
    double worst;            /* J, largest imbalance during the motion */
    double least_friction;   /* J, most negative increment of friction work */
    int count;
    double time[4000], work[4000], stored[4000], dissipated[4000];
} balance;

static double stored(const picture *s) { return s->tissue + s->local + s->needle; }

/* Returns the energy (J) dissipated by friction, cutting, puncture and the damper at the tip. */
static double dissipated(const energies *e) { return e->friction + e->cutting + e->damping + e->freed; }

static void follow(balance *b, const picture *now, double time) {
    const energies *e = &b->total;
    double lost = dissipated(e);
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
    picture *before = picture_create(l), *after = picture_create(l), *stayed = picture_create(l);
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
            add_tick(&l->parts.mesh, before, after, &b->total);
            double bound = bound_by_tip(l, before, after, stayed);
            b->total.freed += bound;
            b->total.handed -= bound;
            b->least_friction = fmin(b->least_friction, b->total.friction - friction);
            follow(b, after, time += tick);
            picture *swap = before;
            before = after, after = swap;
        }
    }
    picture_free(before), picture_free(after), picture_free(stayed);
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

static const char FORCE_TIMES_WAY[] = "more than the work: as the tip moves from the surface into stiffer surroundings (skin puncture, gland), "
                                      "the tissue springs back and does part of the cutting; independent of the tick rate";

static void check_once(rows *r, const char *name, const balance *b) {
    const energies *e = &b->total;
    double taken = e->friction + e->cutting + e->damping;
    char text[160], note[400];
    snprintf(text, sizeof text, "%s: work against force times distance alone", name);
    snprintf(note, sizeof note, "%.2f mJ %s", 1e3 * (taken - e->work), FORCE_TIMES_WAY);
    if (!r->short_form) rows_measured(r, (row){.check = text, .reference = "friction, cutting and puncture", .value = e->work, .expected = taken,
                                      .error = fabs(e->work - taken) / b->most_work, .unit = "J", .note = note});
    snprintf(text, sizeof text, "%s: lost by changes of contact nodes and tributary lengths", name);
    rows_add(r, (row){.check = text, .reference = "nothing", .value = e->handed, .expected = 0.0, .error = fabs(e->handed) / b->most_work, .limit = 0.01,
                      .unit = "J", .note = "error relative to the largest work"});
    snprintf(text, sizeof text, "%s: largest imbalance during the motion", name);
    rows_add(r, (row){.check = text, .reference = "work = stored + dissipated after every tick", .value = b->worst, .expected = 0.0,
                      .error = b->worst / b->most_work, .limit = 0.01, .unit = "J", .note = "error relative to the largest work"});
    snprintf(text, sizeof text, "%s: smallest friction work in a tick", name);
    rows_add(r, (row){.check = text, .reference = "not negative", .value = b->least_friction, .expected = NAN,
                      .error = -b->least_friction / b->most_work, .limit = 1e-6, .unit = "J", .note = "error relative to the largest work"});
}

static void check(rows *r, const char *name, const char *figure, const leg *legs, int leg_count, bool bevelled) {
    double ticks[4], off[4];
    char text[160], note[240];
    int finest = r->short_form ? 1 : 4;
    for (int i = 0; i < finest; i++) {
        ticks[i] = 1e-3 / (1 << i);
        balance *b = run(legs, leg_count, ticks[i], bevelled);
        const energies *e = &b->total;
        off[i] = fabs(e->work - dissipated(e)) / b->most_work;
        snprintf(text, sizeof text, "%s, %g Hz: work against dissipation", name, 1.0 / ticks[i]);
        snprintf(note, sizeof note, "friction %.2f mJ; cutting and puncture: force times distance %.2f, released at the tip %.2f; damper at the tip %.2f; error relative to the largest work",
                 1e3 * e->friction, 1e3 * e->cutting, -1e3 * e->freed, 1e3 * e->damping);
        rows_add(r, (row){.check = text, .reference = "friction, cutting and puncture", .value = e->work, .expected = dissipated(e), .error = off[i],
                          .limit = 0.01, .unit = "J", .note = note});
        snprintf(text, sizeof text, "%s, %g Hz: work of the hand against that of the needle's forces", name, 1.0 / ticks[i]);
        double all = dissipated(e) + e->handed;
        rows_add(r, (row){.check = text, .reference = "dissipation and this loss", .value = e->work, .expected = all,
                          .error = fabs(e->work - all) / b->most_work, .limit = 0.01, .unit = "J", .note = "error relative to the largest work"});
        if (i == 0) {
            draw(r, figure, b);
            check_once(r, name, b);
        }
        free(b);
    }
    rows_curve(r, (curve){.figure = "energy-convergence", .label = name, .x_label = "tick (s)", .y_label = "imbalance over the greatest work",
                          .logarithmic = true, .count = finest, .x = ticks, .y = off});
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: energy balance");
    check(&r, "straight insertion by 70 mm and retraction", "energy-straight", straight, sizeof straight / sizeof *straight, false);
    check(&r, "steered with a bevel: insertion, steering and retraction", "energy-steered", steered, sizeof steered / sizeof *steered, true);
    check(&r, "straight, turned at rest and while it moves", "energy-turned", turned, sizeof turned / sizeof *turned, false);
    return rows_end(&r);
}
