#include "insertion/contact/roll.h"

#include "base/vec.h"
#include "insertion/laws/creep.h"

/* ---- one bound for sliding and turning --------------------------------------------------------------------------------- */

static const double LEAST_WAY = 1e-12; /* m: a shaft whose surface slips by less than this in a step is treated as sticking, because rounding determines the
                                          direction of such a small slip. Rounding tolerance */
static const double LEAST_YIELDING = 1e-12; /* N m / rad: smallest stiffness assumed for the tissue's resistance to rotation. Rounding tolerance */
static const double LEAST_TORQUE = 1e-6; /* N m: added to the torque before multiplying by MARGIN. Rounding tolerance */
static const double LEAST_GAP = 1e-6; /* m: smallest distance assumed between two points on the needle. Rounding tolerance */

double roll_slip_length(double slip, const roll_friction *roll, double radius) {
    return roll->turned == 0.0 ? fabs(slip) : length_of(slip, radius * roll->turned);
}

/* Friction acts against the slip of the shaft's surface. If its bound is F and the surface slides by a along the needle and by w around it, the axial force is
   f(a) = F a / sqrt(a^2 + w^2). Returns the tangent to f at the a of the last solve. */
static shared_bound tangent(double dry, double a, double w) {
    double s = length_of(a, w), along = fabs(a) / s, across = w / s;
    return (shared_bound){dry * along * along * along, dry * across * across / s};
}

/* Returns the bound left for one force while nothing slides: the resultant of both forces must stay within the common bound. */
static double rest_of(double dry, double other) { return sqrt(larger_of(dry * dry - other * other, 0.0)); }

shared_bound roll_bound_for_sliding(double dry, double slip, const roll_friction *roll, double radius) {
    bool slides = roll_slip_length(slip, roll, radius) > LEAST_WAY;
    if (roll->turned != 0.0 && slides) return tangent(dry, slip, radius * fabs(roll->turned));
    return (shared_bound){roll->torque != 0.0 && !slides ? rest_of(dry, roll->torque / radius) : dry, 0.0};
}

shared_bound roll_bound_for_turning(double dry, double slip, double along, const roll_friction *roll, double radius) {
    shared_bound left = {rest_of(dry, along), 0.0};
    if (roll_slip_length(slip, roll, radius) > LEAST_WAY) left = tangent(dry, radius * roll->turned, fabs(slip));
    return (shared_bound){left.bound * radius, left.viscosity * radius * radius};
}

/* ---- the twisted shaft ------------------------------------------------------------------------------------------------- */

void roll_follow_base(insertion_state *state, quat orientation) {
    double turn = q_roll_between(state->needle.base.orientation, orientation);
    state->base_turn += turn;
    state->tip_lead -= turn; /* the tip lags behind until the solve turns it */
}

/* Returns the rotational state of the shaft at a point in the tissue. Guides do not resist rotation. */
static const roll_friction *roll_at(const insertion_state *state, const contact_point *p) { return &point_shaft(state, p)->roll; }

static roll_friction *roll_of(insertion_state *state, const contact_point *p) {
    return p->kind == POINT_TIP ? &state->tip.shaft.roll : &state->contacts[p->handle].shaft.roll;
}

static const contact_point *tissue_points(const contact_points *points) { return &points->list[points->guided]; }

double roll_torque(const insertion_state *state, const contact_points *points) {
    double sum = 0.0;
    for (int i = points->guided; i < points->count; i++) sum += roll_at(state, &points->list[i])->torque;
    return sum;
}

/* One point of the torsional chain. Its torque on the tissue is stiffness * angle + offset. The other members decide whether it sticks. */
typedef struct {
    double shaft;                /* N m / rad, torsional stiffness of the shaft between this point and the previous one (or the base) */
    double yielding;             /* rad / N m, rotational compliance of the tissue around the point's share of the shaft */
    double remembered;           /* N m, torque that relaxing tissue remembers */
    shared_bound bound;
    double stiffness, offset, angle;
} roll_point;

/* Tissue around a shaft rotates only locally: a torque m' per unit length rotates it by m' / (4 pi mu r^2), whatever the mesh. Here, 2 pi mu is the inverse of
   the local compliance along the needle. */
static roll_point point_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const contact_point *p) {
    const insertion_model *model = tick->model;
    bool tip = p->kind == POINT_TIP;
    const shaft_contact *contact = tip ? NULL : &state->contacts[p->handle];
    const roll_friction *roll = roll_at(state, p);
    double radius = model->needle->radius, length = p->share.to - p->share.from, slip = tip ? state->tip.shaft.slip : contact->shaft.slip;
    double slid = tip ? state->tip.shaft.slid : contact->shaft.slid;
    double dry = shaft_friction_limit(model, &p->shaft, slid + roll_slip_length(slip, roll, radius));
    double along = length * (tip ? state->tip.shaft.traction : contact->shaft.traction);
    roll_point point = {.yielding = creep->yield / larger_of(2.0 * radius * radius * p->shaft.axial, LEAST_YIELDING),
                        .bound = roll_bound_for_turning(dry, slip, along, roll, radius)};
    point.bound.viscosity += p->shaft.viscous * radius * radius / tick->dt;
    return point;
}

/* Sets the stiffness and offset of the torque, depending on whether the point sticks or slides. The slip is the shaft's angle minus the tissue's. */
static void take_law(roll_point *p, const roll_friction *roll) {
    if (roll->friction == STICK) {
        p->stiffness = 1.0 / p->yielding;
        p->offset = -roll->anchor / p->yielding - p->remembered;
        return;
    }
    double share = 1.0 + p->bound.viscosity * p->yielding;
    p->stiffness = p->bound.viscosity / share;
    p->offset = (roll->friction * p->bound.bound - p->bound.viscosity * (roll->anchor + p->yielding * p->remembered)) / share;
}

/* Solves for the angles (rad) of the twisted shaft. The points form a chain that starts at the base, and are eliminated in that order. */
static void solve_chain(int n, double base, roll_point *p) {
    double share[MAX_SHARES]; /* fraction of the next point's angle that is added to this point's */
    double held = p[0].shaft, turning = p[0].shaft * base; /* stiffness (N m / rad) and torque (N m) of the chain between the base and this point */
    for (int i = 0; i < n; i++) {
        double after = i + 1 < n ? p[i + 1].shaft : 0.0, inverse = 1.0 / (held + after + p[i].stiffness);
        p[i].angle = (turning - p[i].offset) * inverse;
        share[i] = after * inverse;
        held = after - after * share[i];
        turning = after * p[i].angle;
    }
    for (int i = n - 2; i >= 0; i--) p[i].angle += share[i] * p[i + 1].angle;
}

static double torque_of(const roll_point *p) { return p->stiffness * p->angle + p->offset; }
static double slip_of(const roll_point *p, const roll_friction *roll) { return p->angle - roll->anchor - p->yielding * (torque_of(p) + p->remembered); }

static friction_state consistent(const roll_point *p, const roll_friction *roll) {
    double torque = torque_of(p), margin = MARGIN * (LEAST_TORQUE + fabs(torque));
    if (roll->friction != STICK) return roll->friction * slip_of(p, roll) < 0.0 ? STICK : roll->friction;
    return torque > p->bound.bound + margin ? SLIP_FORWARD : torque < -p->bound.bound - margin ? SLIP_BACKWARD : STICK;
}

/* Switches points between sticking and sliding until all are consistent, as contact_solve does. */
static void search(insertion_state *state, const contact_points *points, int n, roll_point *chain) {
    const contact_point *at = tissue_points(points);
    for (int round = 0; round < ROUNDS_TOGETHER + ROUNDS_EACH * n; round++) {
        bool done = true;
        for (int i = 0; i < n; i++) take_law(&chain[i], roll_at(state, &at[i]));
        solve_chain(n, state->base_turn, chain);
        for (int i = 0; i < n; i++) {
            roll_friction *roll = roll_of(state, &at[i]);
            friction_state next = consistent(&chain[i], roll);
            if (next == roll->friction || (!done && round >= ROUNDS_TOGETHER)) continue;
            roll->friction = next;
            done = false;
        }
        if (done) return;
    }
}

/* Anchors new points at the shaft's current roll angle, where the tissue around them is unstrained. Returns false if there is no twist anywhere, so there is
   nothing to solve. */
static bool anchor_points(insertion_state *state, const contact_points *points) {
    bool twisted = state->tip_lead != 0.0;
    for (int i = points->guided; i < points->count; i++) {
        roll_friction *roll = roll_of(state, &points->list[i]);
        if (isnan(roll->anchor)) *roll = (roll_friction){.anchor = state->base_turn + state->tip_lead};
        twisted = twisted || roll->anchor != state->base_turn || roll->torque != 0.0;
    }
    return twisted;
}

/* Returns link i of the torsional chain, which does not include guides. */
static roll_point chain_link(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep, int i) {
    const contact_point *at = tissue_points(points);
    roll_point point = point_at(tick, state, creep, &at[i]);
    point.shaft = tick->model->needle->torsion / larger_of(at[i].arc - (i > 0 ? at[i - 1].arc : 0.0), LEAST_GAP);
    point.remembered = creep_twist(tick, creep, points->guided + i);
    return point;
}

double roll_stiffness(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep) {
    roll_point chain[MAX_SHARES];
    int n = points->count - points->guided;
    double sum = 0.0;
    for (int i = 0; i < n; i++) {
        roll_friction roll = *roll_at(state, &tissue_points(points)[i]);
        chain[i] = chain_link(tick, state, points, creep, i);
        if (chain[i].bound.bound == 0.0 && chain[i].bound.viscosity > 0.0) roll.friction = SLIP_FORWARD; /* it slides lengthwise, so it can turn freely */
        take_law(&chain[i], &roll);
        chain[i].offset = 0.0;
    }
    if (n > 0) solve_chain(n, 1.0, chain);
    for (int i = 0; i < n; i++) sum += torque_of(&chain[i]);
    return sum;
}

void roll_solve(const tick_input *tick, insertion_state *state, const contact_points *points, const creep_step *creep) {
    roll_point chain[MAX_SHARES];
    const contact_point *at = tissue_points(points);
    int n = points->count - points->guided;
    if (n == 0 || !anchor_points(state, points)) return;
    for (int i = 0; i < n; i++) chain[i] = chain_link(tick, state, points, creep, i);
    search(state, points, n, chain);
    for (int i = 0; i < n; i++) {
        roll_friction *roll = roll_of(state, &at[i]);
        roll->torque = torque_of(&chain[i]);
        roll->turned = roll->friction == STICK ? 0.0 : slip_of(&chain[i], roll);
        roll->anchor += roll->turned;
    }
    state->tip_lead = chain[n - 1].angle - state->base_turn;
}
