#include "view/hand/hole_approach.h"

#include "common/messages.h"

static const double CLEARANCE = 0.003; /* m, gap between the tip and the template while the needle waits */
static const double HERE = 1e-9;       /* m and rad, below which distances and angles count as zero */
static const double IN_LINE = 0.5e-3;  /* m, farthest that base and tip may be from the hole's axis for the needle to count as aligned with it */

pose hole_home(const trocar_guide *guide, double column, double row, double needle_length) {
    pose home = hole_entry(guide, column, row);
    home.position = v3_axpy(-needle_length - CLEARANCE, q_axis(home.orientation), home.position);
    return home;
}

pose hole_home_beside(const trocar_guide *guide, pose base, double needle_length) {
    vec3 from = v3_sub(base.position, load_vec3(guide->origin));
    double column = round(v3_dot(from, load_vec3(guide->across[0])) / guide->spacing + 0.5 * (guide->columns - 1));
    double row = round(v3_dot(from, load_vec3(guide->across[1])) / guide->spacing + 0.5 * (guide->rows - 1));
    return hole_home(guide, fmax(0, fmin(column, guide->columns - 1)), fmax(0, fmin(row, guide->rows - 1)), needle_length);
}

bool in_line_with_hole(pose home, pose base, double needle_length) {
    quat to_home = q_conjugate(home.orientation);
    vec3 from = q_rotate(to_home, v3_sub(base.position, home.position)), tip = v3_axpy(needle_length, q_rotate(to_home, q_axis(base.orientation)), from);
    return hypot(from.x, from.y) < IN_LINE && hypot(tip.x, tip.y) < IN_LINE;
}

/* Returns the fraction of the distance `rest` that remains after a step of at most `most`. */
static double left_of(double rest, double most) { return rest > most ? (rest - most) / rest : 0.0; }

bool approach_step(rate_control_state *d, const rate_control_limits *limits, double dt) {
    quat home = d->home.orientation;
    vec3 x = q_rotate(q_conjugate(home), v3_sub(d->base.position, d->home.position));
    vec3 turn = q_log(q_multiply(q_conjugate(home), d->base.orientation));
    double step = 2.0 * limits->max_speed * dt, aside = hypot(x.x, x.y);
    d->velocity = d->turn = v3(0, 0, 0);
    bool is_in_line = aside < HERE && v3_norm(turn) < HERE;
    x.z *= left_of(fabs(x.z), step);
    if (is_in_line || x.z < HERE) {
        double rest = left_of(aside, step);
        x = v3(rest * x.x, rest * x.y, x.z);
        turn = v3_scale(left_of(v3_norm(turn), 2.0 * limits->max_turn_rate * dt), turn);
    }
    bool arrived = x.x == 0.0 && x.y == 0.0 && x.z == 0.0 && v3_norm(turn) == 0.0;
    d->base = arrived ? d->home : (pose){v3_add(d->home.position, q_rotate(home, x)), q_unit(q_multiply(home, q_exp(turn)))};
    return arrived;
}
