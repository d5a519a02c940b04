#include "hole_approach.h"

static const double CLEARANCE = 0.003; /* m, of the tip in front of the template */
static const double HERE = 1e-9;       /* m and rad, rounding */

int find_template(const trocar_model *model) {
    for (int i = 0; i < trocar_model_guide_count(model); i++) {
        trocar_guide guide = trocar_model_guide(model, i);
        if (guide.columns * guide.rows > 1) return i;
    }
    return -1;
}

static vec3 vector(const double *x) { return v3(x[0], x[1], x[2]); }

/* Turns z to `axis` and x to `along`, perpendicular unit vectors. */
static quat frame_of(vec3 axis, vec3 along) {
    vec3 z = v3(0, 0, 1), turn = v3_cross(z, axis);
    double sine = v3_norm(turn), angle = atan2(sine, v3_dot(z, axis));
    quat tilted = q_exp(sine > 1e-12 ? v3_scale(angle / sine, turn) : v3(angle, 0, 0));
    double roll = atan2(v3_dot(along, q_rotate(tilted, v3(0, 1, 0))), v3_dot(along, q_rotate(tilted, v3(1, 0, 0))));
    return q_unit(q_multiply(tilted, q_exp(v3(0, 0, roll))));
}

pose hole_home(const trocar_guide *guide, double column, double row, double needle_length) {
    vec3 columns = vector(guide->across[0]), rows = vector(guide->across[1]), normal = vector(guide->normal);
    vec3 place = v3_axpy((column - 0.5 * (guide->columns - 1)) * guide->spacing, columns, vector(guide->origin));
    place = v3_axpy((row - 0.5 * (guide->rows - 1)) * guide->spacing, rows, place);
    return (pose){v3_axpy(-needle_length - CLEARANCE, normal, place), frame_of(normal, v3_cross(rows, normal))};
}

/* The part of `rest` that a step of at most `most` leaves. */
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
