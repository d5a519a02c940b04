/* The virtual operator (trocar/operator.h). Its list of steps is fixed when it is created. In each step it chooses actions, based on what it sees, until the
   step is done. */
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h"
#include "api/view.h"
#include "base/vec.h"

static const double CLEAR = 0.005;      /* m, how far the tip stays clear of the guide before insertion and after withdrawal */
static const double PAUSE = 0.1;        /* s, pause before letting go of a needle and before dropping a seed */
static const double FURTHER = 1e-3;     /* m, how far a needle is drawn back if the previous seed is still in it */
static const int REPEATS = 20;          /* number of times a needle may be drawn back to release the previous seed */
static const double AT_TARGET = 0.3e-3; /* m, the depth is not corrected if the image shows the tip within this distance of its target */
static const double SAME_SPACING = 1e-5; /* m, rounding error of positions in a plan; seeds whose spacings differ by less are dropped together */
static const int CORRECTIONS = 5;       /* maximum number of corrective strokes per target. One stroke may not be enough, because the needle displaces the
                                           target as it moves */

/* Limits on a needle's speed as a multiple of the mean, from published hand speeds: peaks from 40 to 280 mm/s, with a mean of 123 mm/s. See docs/seeds.md. */
static const double SLOWEST = 0.040 / 0.123, FASTEST = 0.280 / 0.123;
static const trocar_operator_options PUBLISHED = {.follows_image = 1, .seed = 1, .image_error = 0.65e-3, .splay = 0.0104, .speed = 0.065, .speed_spread = 0.33};

/* A target: the planned centre of a seed, half a seed length behind the planned tip position, as a point of the undeformed tissue. */
typedef struct {
    double depth;            /* m, planned depth of the tip */
    vec3 place;              /* m, mesh coordinates */
    int32_t nodes[4];        /* corners of the tetrahedron that contains the point */
    double weights[4];
} target;

typedef struct {
    vec3 entry, axis;        /* the planned axis */
    quat orientation;        /* the needle's orientation, including its tilt */
    vec3 pivot, tilted;      /* a point on the tilted axis (m), and the axis's direction (unit vector) */
    double pivot_depth;      /* m, depth at which the tip is at the pivot */
    double image_error;      /* m, error along the needle's axis in reading the image */
    double speed;            /* m/s */
    int first, seeds;        /* first: index of the target for the full insertion depth. seeds: how many seeds the needle holds; their targets come next */
} handled;

typedef enum { START, INSERT, LEAVE, TAKE, DRAW_BACK, DROP, WITHDRAW, FINISHED } step_kind;
typedef struct {
    step_kind kind;
    int needle, number;      /* index of the needle, and of the seed in it, counted from the distal end */
    int seeds;               /* DROP: how many seeds, from this one on */
} step;

struct trocar_operator {
    bool follows_image, strands;
    double strand_depth;     /* m, depth of the tip when the needle's first seed was dropped */
    double needle_length, half_seed; /* m */
    int needle_count, step_count, seed_count;
    int at, actions;         /* current step, and how many actions it has chosen so far */
    trocar_operator_sight sight; /* what the operator last saw. `displacements` is valid only during a call to trocar_operator_next */
    handled needles[TROCAR_MAX_NEEDLES];
    target targets[TROCAR_MAX_NEEDLES + TROCAR_MAX_SEEDS];
    step steps[6 * TROCAR_MAX_NEEDLES + 2 * TROCAR_MAX_SEEDS + 1];
    trocar_operator_seed seeds[TROCAR_MAX_SEEDS];
};

static vec3 load_vec3(const double v[3]) { return v3(v[0], v[1], v[2]); }

/* ---- random numbers --------------------------------------------------------------------------------------------------------- */

static const uint64_t GOLDEN = 0x9e3779b97f4a7c15u;

/* splitmix64 (Steele, Lea and Flood, OOPSLA 2014) */
static uint64_t next_bits(uint64_t *state) {
    uint64_t z = *state += GOLDEN;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

/* Returns a standard normal deviate (Box and Muller 1958). */
static double normal(uint64_t *state) {
    double u = (double)((next_bits(state) >> 11) + 1) * 0x1p-53, v = (double)(next_bits(state) >> 11) * 0x1p-53;
    return sqrt(-2.0 * log(u)) * cos(2.0 * 3.14159265358979323846 * v);
}

/* Tilts the needle about the middle of its guide hole by the angles x and y (rad), limited to the tilt at which the needle touches the hole's edges on both
   faces of the guide. The axes of x and y are perpendicular to the needle and depend only on its direction. */
static void tilt(const trocar_model *model, int index, double x, double y, handled *n) {
    double most = INFINITY, thickness = 0.0;
    if (index >= 0) {
        const guide_config *guide = &model->parts.config.guides[index];
        thickness = guide->thickness;
        if (thickness > 0.0) most = (guide->hole_diameter - model->parts.config.needle.outer_diameter) / thickness;
    }
    mat3 frame = frame_along(n->axis);
    vec3 turn = m3_apply(&frame, v3(x, y, 0.0));
    double angle = v3_norm(turn);
    if (angle == 0.0) return;
    n->orientation = q_unit(q_multiply(q_exp(v3_scale(fmin(angle, most) / angle, turn)), n->orientation));
    n->tilted = q_axis(n->orientation);
    n->pivot_depth = 0.5 * thickness;
    n->pivot = v3_axpy(n->pivot_depth, n->axis, n->entry);
}

/* Draws the needle's random properties: image error, speed and tilt. */
static void draw(const trocar_model *model, const trocar_operator_options *options, const trocar_operator_needle *planned, int index, handled *n) {
    uint64_t state = options->seed + GOLDEN * (uint64_t)(index + 1);
    state = next_bits(&state);
    double image = normal(&state), x = normal(&state), y = normal(&state), speed = normal(&state), spread = options->speed_spread;
    n->image_error = options->image_error * image;
    n->speed = options->speed;
    if (spread > 0.0) n->speed *= fmin(fmax(exp(spread * speed - 0.5 * spread * spread), SLOWEST), FASTEST);
    tilt(model, planned->guide, options->splay * x, options->splay * y, n);
}

/* ---- creation ------------------------------------------------------------------------------------------------------------------ */

static bool find_place(const mesh *m, vec3 place, target *t) {
    int tet = mesh_locate(m, place, -1);
    if (tet < 0) return false;
    for (int c = 0; c < 4; c++) t->nodes[c] = m->tets[tet][c];
    mesh_barycentric(m, tet, place, t->weights);
    t->place = place;
    return true;
}

static trocar_status add_target(trocar_operator *op, const trocar_model *model, int index, double depth, target *t, trocar_error *why) {
    const handled *n = &op->needles[index];
    t->depth = depth;
    if (!(depth > 0.0 && depth < op->needle_length))
        return fail(why, TROCAR_BAD_INPUT, "needle %d: a depth of %g m: expected more than 0 and less than the needle's length, %g m", index, depth, op->needle_length);
    if (find_place(&model->parts.mesh, v3_axpy(depth - op->half_seed, n->axis, n->entry), t)) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "needle %d: with its tip at %g m, a seed would not be in the tissue at rest", index, depth);
}

static trocar_status add_needle(trocar_operator *op, const trocar_model *model, const trocar_operator_needle *planned, int index,
                                const trocar_operator_options *options, int *targets, trocar_error *why) {
    handled *n = &op->needles[index];
    const double *q = planned->entry.orientation;
    if (planned->guide < -1 || planned->guide >= model->parts.config.guide_count)
        return fail(why, TROCAR_BAD_INPUT, "needle %d: no guide %d: the scene has %d, numbered from 0", index, planned->guide, model->parts.config.guide_count);
    if (planned->seed_count < 0 || planned->seed_count > TROCAR_MAX_SEEDS - op->seed_count)
        return fail(why, TROCAR_BAD_INPUT, "needle %d has %d seeds: a plan has at most %d", index, planned->seed_count, (int)TROCAR_MAX_SEEDS);
    n->entry = n->pivot = load_vec3(planned->entry.position);
    n->orientation = (quat){q[0], q[1], q[2], q[3]};
    n->axis = n->tilted = q_axis(n->orientation);
    n->first = *targets;
    n->seeds = planned->seed_count;
    op->seed_count += planned->seed_count;
    draw(model, options, planned, index, n);
    trocar_status status = add_target(op, model, index, planned->depth, &op->targets[(*targets)++], why);
    for (int i = 0; status == TROCAR_OK && i < planned->seed_count; i++) {
        double above = i == 0 ? planned->depth : planned->seeds[i - 1];
        if (!(planned->seeds[i] <= above)) return fail(why, TROCAR_BAD_INPUT, "needle %d: seed %d is not behind what comes before it: list seeds from the tip back", index, i);
        if (op->strands && i > 0 && above - planned->seeds[i] < 2.0 * op->half_seed - SAME_SPACING)
            return fail(why, TROCAR_BAD_INPUT, "needle %d: seeds %d and %d overlap: in a strand, plan them at least the scene's seeds.length apart", index, i - 1, i);
        status = add_target(op, model, index, planned->seeds[i], &op->targets[(*targets)++], why);
    }
    return status;
}

static void add_step(trocar_operator *op, step_kind kind, int needle, int number) { op->steps[op->step_count++] = (step){kind, needle, number, 1}; }

/* Returns how many seeds of the needle, from this one on, can be dropped at once because they belong to a strand and are equally spaced. */
static int seeds_together(const trocar_operator *op, const handled *n, int number) {
    const target *t = &op->targets[n->first + 1 + number];
    int most = op->strands ? n->seeds - number : 1, count = most > 1 ? 2 : 1;
    if (most > TROCAR_MAX_STRAND) most = TROCAR_MAX_STRAND;
    while (count < most && fabs(t[0].depth - t[1].depth - (t[count - 1].depth - t[count].depth)) < SAME_SPACING) count++;
    return count;
}

static void plan_insertion(trocar_operator *op, int needle) {
    add_step(op, START, needle, 0);
    add_step(op, INSERT, needle, 0);
    add_step(op, LEAVE, needle, 0);
}

static void plan_withdrawal(trocar_operator *op, int needle) {
    const handled *n = &op->needles[needle];
    add_step(op, TAKE, needle, 0);
    for (int i = 0, together; i < n->seeds; i += together) {
        together = seeds_together(op, n, i);
        add_step(op, DRAW_BACK, needle, i);
        add_step(op, DROP, needle, i);
        op->steps[op->step_count - 1].seeds = together;
    }
    add_step(op, WITHDRAW, needle, 0);
}

/* Calls `plan` for each needle that holds seeds or, if `with_seeds` is false, for each one that doesn't (the stabilising needles). */
static void for_needles(trocar_operator *op, bool with_seeds, void (*plan)(trocar_operator *, int)) {
    for (int i = 0; i < op->needle_count; i++)
        if (with_seeds == (op->needles[i].seeds > 0)) plan(op, i);
}

static trocar_status check_options(const trocar_operator_options *o, trocar_error *why) {
    if (!(o->image_error >= 0.0 && o->image_error <= 0.1)) return fail(why, TROCAR_BAD_INPUT, "an image error of %g m: expected 0 to 0.1", o->image_error);
    if (!(o->splay >= 0.0 && o->splay <= 0.5)) return fail(why, TROCAR_BAD_INPUT, "a splay of %g rad: expected 0 to 0.5", o->splay);
    if (!(o->speed >= 1e-4 && o->speed <= 10.0)) return fail(why, TROCAR_BAD_INPUT, "a speed of %g m/s: expected 0.0001 to 10", o->speed);
    if (!(o->speed_spread >= 0.0 && o->speed_spread <= 3.0)) return fail(why, TROCAR_BAD_INPUT, "a spread of speeds of %g: expected 0 to 3", o->speed_spread);
    return TROCAR_OK;
}

static trocar_status fill(trocar_operator *op, const trocar_model *model, const trocar_operator_needle *needles, const trocar_operator_options *options,
                          trocar_error *why) {
    int targets = 0;
    trocar_status status = check_options(options, why);
    for (int i = 0; status == TROCAR_OK && i < op->needle_count; i++) status = add_needle(op, model, &needles[i], i, options, &targets, why);
    for_needles(op, false, plan_insertion);
    for_needles(op, true, plan_insertion);
    for_needles(op, true, plan_withdrawal);
    for_needles(op, false, plan_withdrawal);
    add_step(op, FINISHED, 0, 0);
    op->seed_count = 0; /* from here on, this counts the seeds dropped */
    return status;
}

trocar_operator_options trocar_default_operator_options(int follows_image) {
    return follows_image ? PUBLISHED : (trocar_operator_options){.seed = PUBLISHED.seed, .speed = PUBLISHED.speed};
}

trocar_status trocar_operator_create(const trocar_model *model, const trocar_operator_needle *needles, int count, const trocar_operator_options *options,
                                     trocar_operator **op, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    trocar_operator_options standard = trocar_default_operator_options(0);
    *op = NULL;
    if (!options) options = &standard;
    if (count < 1 || count > model->parts.config.needle_count)
        return fail(why, TROCAR_BAD_INPUT, "%d needles: the scene has %d; set \"needles\" in the scene", count, model->parts.config.needle_count);
    trocar_operator *made = calloc(1, sizeof *made);
    if (!made) return fail(why, TROCAR_NO_MEMORY, "no memory for an operator");
    made->follows_image = options->follows_image;
    made->strands = options->strands;
    made->needle_length = model->parts.config.needle.length;
    made->half_seed = 0.5 * model->parts.config.seeds.length;
    made->needle_count = count;
    trocar_status status = fill(made, model, needles, options, why);
    if (status == TROCAR_OK) *op = made;
    else free(made);
    return status;
}

void trocar_operator_free(trocar_operator *op) { free(op); }

/* ---- poses and depths -------------------------------------------------------------------------------------------------------- */

trocar_pose trocar_operator_base(const trocar_operator *op, int needle, double depth) {
    const handled *n = &op->needles[needle];
    return pose_out((pose){v3_axpy(depth - n->pivot_depth - op->needle_length, n->tilted, n->pivot), n->orientation});
}

double trocar_operator_depth(const trocar_operator *op, int needle, const trocar_pose *base) {
    const handled *n = &op->needles[needle];
    return op->needle_length + n->pivot_depth + v3_dot(v3_sub(load_vec3(base->position), n->pivot), n->tilted);
}

/* Returns how far (m) the newest image shows a target displaced. */
static vec3 displacement_of(const trocar_operator *op, const target *t) {
    vec3 moved = v3(0, 0, 0);
    for (int c = 0; op->sight.displacements && c < 4; c++) moved = v3_axpy(t->weights[c], load_vec3(&op->sight.displacements[3 * t->nodes[c]]), moved);
    return moved;
}

/* Returns the depth at which the operator would stop for a target. An operator who follows the image stops where the image shows the tip level with the
   displaced target; otherwise, this is the planned depth. */
static double wanted_depth(const trocar_operator *op, const handled *n, const target *t) {
    return op->follows_image ? t->depth + v3_dot(displacement_of(op, t), n->axis) + n->image_error : t->depth;
}

/* ---- steps ----------------------------------------------------------------------------------------------------------------------- */

static bool move(const trocar_operator *op, const handled *n, double depth, double pause, trocar_operator_action *action) {
    action->act = TROCAR_OPERATOR_MOVE;
    action->depth = depth;
    action->duration = fabs(depth - op->sight.depth) / n->speed;
    action->pause = pause;
    return true;
}

/* Moves the tip to a target and, if the image then shows it off the target, corrects the depth. */
static bool approach(const trocar_operator *op, const handled *n, const target *t, trocar_operator_action *action) {
    double depth = wanted_depth(op, n, t);
    bool off = op->follows_image && op->actions <= CORRECTIONS && fabs(depth - op->sight.depth) > AT_TARGET;
    return (op->actions == 0 || off) && move(op, n, depth, PAUSE, action);
}

/* Draws the needle back to where a seed of a strand leaves it, at the planned distance from the strand's first seed. */
static bool draw_back_strand(const trocar_operator *op, const handled *n, int number, trocar_operator_action *action) {
    const target *seeds = &op->targets[n->first + 1];
    double depth = op->strand_depth - (seeds[0].depth - seeds[number].depth);
    return op->actions == 0 && move(op, n, fmin(depth, op->sight.depth), PAUSE, action);
}

/* Draws the needle back to a seed's target. If the tip is already there or behind it, the needle stays where it is. Only for the first seed may it be pushed
   forward. */
static bool draw_back(trocar_operator *op, const handled *n, int number, trocar_operator_action *action) {
    const target *t = &op->targets[n->first + 1 + number];
    if (op->strands && number > 0) return draw_back_strand(op, n, number, action);
    if (op->actions > 0 || number == 0 || wanted_depth(op, n, t) < op->sight.depth) return approach(op, n, t, action);
    op->actions = CORRECTIONS + 1;
    return move(op, n, op->sight.depth, PAUSE, action);
}

/* Records a seed that was dropped with its distal end at this depth (m). */
static void record_seed(trocar_operator *op, int needle, int number, double depth) {
    const handled *n = &op->needles[needle];
    const target *t = &op->targets[n->first + 1 + number];
    double centre = depth - op->half_seed;
    vec3 straight = v3_axpy(centre, n->axis, n->entry);
    vec3 image = v3_scale(op->follows_image ? n->image_error : 0.0, n->axis);
    vec3 tissue = v3_sub(v3_sub(straight, image), v3_add(t->place, displacement_of(op, t)));
    trocar_operator_seed *seed = &op->seeds[op->seed_count++];
    *seed = (trocar_operator_seed){.needle = needle, .number = number};
    store_vec3(t->place, seed->planned);
    store_vec3(tissue, seed->tissue);
    store_vec3(image, seed->image);
    store_vec3(v3_sub(v3_axpy(centre - n->pivot_depth, n->tilted, n->pivot), straight), seed->splay);
}

/* Returns the distance (m) between the centres of the seeds that a step drops at once, or 0 if there is only one. At least the length of a seed, of which a
   rounded plan may fall short. */
static double spacing_of(const trocar_operator *op, const step *s) {
    const target *t = &op->targets[op->needles[s->needle].first + 1 + s->number];
    return s->seeds > 1 ? fmax((t[0].depth - t[s->seeds - 1].depth) / (s->seeds - 1), 2.0 * op->half_seed) : 0.0;
}

/* Drops seeds. If the last attempt was refused because an earlier seed is still in the needle, draws the needle back a little before trying again. */
static bool drop(trocar_operator *op, const step *s, trocar_operator_action *action) {
    bool dropped = op->actions % 2 == 1;
    if (dropped && op->sight.refused) return move(op, &op->needles[s->needle], op->sight.depth - FURTHER, 0.0, action);
    action->act = TROCAR_OPERATOR_DROP;
    action->seeds = s->seeds;
    action->spacing = spacing_of(op, s);
    if (dropped && s->number == 0) op->strand_depth = op->sight.depth;
    for (int i = 0; dropped && i < s->seeds; i++) record_seed(op, s->needle, s->number + i, op->sight.depth - i * action->spacing);
    return !dropped;
}

/* Chooses the step's next action. Returns false if the step is done. */
static bool choose(trocar_operator *op, const step *s, trocar_operator_action *action) {
    const handled *n = &op->needles[s->needle];
    bool first = op->actions == 0;
    *action = (trocar_operator_action){.needle = s->needle, .depth = op->sight.depth};
    switch (s->kind) {
    case START:
        action->act = TROCAR_OPERATOR_START;
        action->depth = -CLEAR;
        return first;
    case INSERT: return approach(op, n, &op->targets[n->first], action);
    case LEAVE: action->act = TROCAR_OPERATOR_LEAVE; return first;
    case TAKE: action->act = TROCAR_OPERATOR_TAKE; return first;
    case DRAW_BACK: return draw_back(op, n, s->number, action);
    case DROP: return drop(op, s, action);
    case WITHDRAW: return first && move(op, n, -CLEAR, 0.0, action);
    case FINISHED:
    default: action->act = TROCAR_OPERATOR_FINISHED; return true;
    }
}

trocar_status trocar_operator_next(trocar_operator *op, const trocar_operator_sight *sight, trocar_operator_action *action, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (op->at > 0 || op->actions > 0) op->sight = *sight;
    if (op->steps[op->at].kind == DROP && op->sight.refused && op->actions > 2 * REPEATS)
        return fail(why, TROCAR_SYSTEM, "needle %d was drawn back %d times, and the previous seed is still in it", op->steps[op->at].needle, REPEATS);
    while (!choose(op, &op->steps[op->at], action)) {
        op->at++;
        op->actions = 0;
    }
    op->actions++;
    op->sight.displacements = NULL;
    return TROCAR_OK;
}

int trocar_operator_seeds(const trocar_operator *op, trocar_operator_seed *seeds, int room) {
    for (int i = 0; i < op->seed_count && i < room; i++) seeds[i] = op->seeds[i];
    return op->seed_count;
}
