#include "insertion/tip.h"

#include <string.h>

enum { MAX_STEPS = 256 };                    /* elements crossed in one tick, at most */
static const double FACE_CLEARANCE = 1e-7;   /* m, the tip is put this far past a face that it crosses */
static const double PLAN_TOLERANCE = 2e-4;   /* m, a planned contact node serves if the tip passes it this closely */
static const double MOST_SHEAR = 0.7;        /* of the tissue along the track, that the tip's direction follows */
static const double GLIDE_REACH = 2e-3;      /* m, how far above and below a gliding tip the surface is looked for */
static const double GRAZING = 0.2;           /* sine of the angle to an outer face, below which the tip goes along the face */
static const double GRAZING_DEPTH = 1e-5;    /* m inside that face, where `nominal` is then */
static const double OVERLAP = 2e-3;          /* m, bodies that were meshed apart may overlap by so much */

static const region_material *material_at(const insertion_model *model, int tet) {
    return &model->materials[model->mesh->region[tet]];
}

double tip_resistance(const insertion_model *model, const needle_tip *tip) {
    double cutting = material_at(model, tip->tet)->cutting_force;
    if (tip->blocked_by == BLOCKED_BY_BONE) return INFINITY;
    return tip->blocked_by == NOT_BLOCKED ? cutting : fmax(cutting, model->membranes[tip->blocked_by].puncture_force);
}

/* What stops the tip at a face, with `behind` the element on the other side (-1: none): bone, the strongest membrane, or nothing. */
static int obstacle(const insertion_model *model, int tet, int face, int behind) {
    if (behind >= 0 && isinf(material_at(model, behind)->cutting_force)) return BLOCKED_BY_BONE;
    int strongest = NOT_BLOCKED;
    for (int i = 0; i < model->membrane_count; i++)
        if (model->mesh->face_groups[tet][face] >> model->membranes[i].group & 1
            && (strongest < 0 || model->membranes[i].puncture_force > model->membranes[strongest].puncture_force)) strongest = i;
    return strongest;
}

/* Where the tip cuts to: along the needle, and sideways away from the bevel's face. */
static vec3 needle_direction(const insertion_model *model, const insertion_state *state) {
    quat frame = state->needle.frames[model->needle->given.segments - 1];
    return q_rotate(frame, v3(0, -model->needle->given.bevel_slope, 1.0));
}

/* ---- contact nodes --------------------------------------------------------------------------------------------------- */

/* Of the last one that the tip has passed. */
static double last_contact_depth(const insertion_state *state) {
    int passed = contacts_passed(state);
    return passed > 0 ? state->contacts[passed - 1].depth : -INFINITY;
}

/* Added on the face, or inside where moved nodes have taken the face elsewhere. */
static int add_instead(const mesh *m, refinement *r, int tet, vec3 position, uint64_t id) {
    int index = refinement_add_on_face(m, r, tet, position, id);
    if (v3_norm(v3_sub(r->nodes[index].position, position)) < PLAN_TOLERANCE) return index;
    r->count--;
    return refinement_add(m, r, tet, position, id);
}

static int move_or_add(const insertion_model *model, refinement *r, int near, vec3 position, uint64_t id, insertion_wrench *wrench) {
    double weights[4];
    int tet = refinement_element(model->mesh, r, r->count, near, position, weights), index = refinement_move(model->tissue, r, tet, position, id);
    if (index >= 0) return index;
    wrench->events |= EVENT_KEPT;
    return add_instead(model->mesh, r, tet, position, id);
}

/* Adds a contact node; false when there is no room. */
static bool add_contact(const insertion_model *model, insertion_state *state, vec3 position, double depth, insertion_wrench *wrench) {
    if (state->refined.count == MAX_CONTACTS) {
        wrench->events |= EVENT_FULL;
        return false;
    }
    uint64_t id = ++state->next_id;
    int tet = state->tip.tet, index;
    switch (model->settings.placement) {
    case PLACE_ON_FACES: index = refinement_add_on_face(model->mesh, &state->refined, tet, position, id); break;
    case PLACE_MOVED: index = move_or_add(model, &state->refined, tet, position, id, wrench); break;
    default: index = refinement_add(model->mesh, &state->refined, tet, position, id); break;
    }
    state->contacts[index] = (shaft_contact){.track = position, .depth = depth};
    return true;
}

static void drop_plan(insertion_state *state) {
    if (state->tip.planned) state->refined.count--;
    state->tip.planned = false;
    state->tip.next_contact = NAN;
}

/* On entering an element: its contact node is due half way through (else: where the tip leaves it), but not closer to the last
   one than the spacing. Asked for now, its row of the inverse is there when the tip is. */
static void plan_contact(const insertion_model *model, insertion_state *state, vec3 direction, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    double chord;
    drop_plan(state);
    tip->next_contact = INFINITY;
    direction = tip_way(tip, direction);
    if (mesh_exit(model->mesh, tip->tet, tip->nominal, direction, &chord) < 0) return;
    double earliest = last_contact_depth(state) + model->settings.contact_spacing;
    if (model->settings.placement != PLACE_INSIDE) { /* left on crossing the face, not at a depth */
        if (tip->depth + chord >= earliest)
            tip->planned = add_contact(model, state, v3_axpy(chord, direction, tip->nominal), tip->depth + chord, wrench);
        return;
    }
    double due = fmax(tip->depth + 0.5 * chord, earliest);
    if (due >= tip->depth + 0.95 * chord) return;
    tip->next_contact = due;
    tip->planned = add_contact(model, state, v3_axpy(due - tip->depth, direction, tip->nominal), due, wrench);
}

/* Leaves a contact node behind at the tip: the planned one, or a new one where the tip came elsewhere. It takes part as
   soon as the worker has its row. */
static void leave_contact(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    bool met = tip->planned && v3_norm(v3_sub(state->contacts[state->refined.count - 1].track, tip->nominal)) < PLAN_TOLERANCE;
    if (!met) drop_plan(state);
    if (met || add_contact(model, state, tip->nominal, tip->depth, wrench)) {
        shaft_contact *contact = &state->contacts[state->refined.count - 1];
        *contact = (shaft_contact){.arc = model->needle->given.length, .track = tip_place(tip), .beside = tip->beside, .direction = tip->direction, .depth = tip->depth, .slip = tip->shaft_slip, .slid = tip->shaft_slid,
                                   .friction = tip->shaft_friction};
    }
    tip->planned = false;
    tip->next_contact = INFINITY;
}

/* Notes where the track goes into another region, or into a gap. */
static void note_stratum(insertion_state *state, int region, insertion_wrench *wrench) {
    const needle_tip *tip = &state->tip;
    int last = state->stratum_count - 1;
    if (last >= 0 && state->strata[last].region == region) return;
    if (last + 1 < MAX_STRATA) state->strata[state->stratum_count++] = (stratum){tip->depth, region, tip->tet, tip->nominal};
    else wrench->events |= EVENT_FULL;
}

static void enter_stratum(const mesh *m, insertion_state *state, insertion_wrench *wrench) {
    note_stratum(state, m->region[state->tip.tet], wrench);
}

/* The last gap among the strata, or -1. */
static int last_gap(const insertion_state *state) {
    int k = state->stratum_count - 1;
    while (k >= 0 && state->strata[k].region != IN_A_GAP) k--;
    return k;
}

double tip_entry_depth(const insertion_state *state) {
    int gap = last_gap(state);
    return gap >= 0 ? state->strata[gap + 1].depth : 0.0;
}

static void leave_strata(insertion_state *state) {
    while (state->stratum_count > 1 && state->strata[state->stratum_count - 1].depth > state->tip.depth) state->stratum_count--;
}

/* The tip is a little out of an outer face, or not. */
static void set_beside(needle_tip *tip, vec3 beside) {
    tip->beside = beside;
    tip->outward = v3_norm(beside) > 0.0 ? v3_unit(beside) : v3(0, 0, 0);
}

/* The tip has come back to its last contact node and takes its place. Moved nodes may have taken node->tet elsewhere. */
static void take_up_contact(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    int last = --state->refined.count;
    const added_node *node = &state->refined.nodes[last];
    needle_tip *tip = &state->tip;
    double weights[4];
    tip->nominal = v3_sub(state->contacts[last].track, state->contacts[last].beside);
    set_beside(tip, state->contacts[last].beside);
    tip->tet = refinement_element(model->mesh, &state->refined, 0, node->tet, tip->nominal, weights);
    tip->direction = state->contacts[last].direction;
    tip->depth = state->contacts[last].depth;
    tip->shaft_slid = state->contacts[last].slid;
    tip->next_contact = NAN;
    leave_strata(state);
    if (state->active > last) state->active = last;
    wrench->events |= EVENT_REMOVED;
}

/* ---- walking --------------------------------------------------------------------------------------------------------- */

/* Follows the segment from the tip's nominal point to `target`, element by element, as far as there is tissue.
   Returns the element reached. */
static int follow(const mesh *m, int tet, vec3 *from, vec3 target) {
    for (int step = 0; step < MAX_STEPS; step++) {
        vec3 rest = v3_sub(target, *from);
        double fraction;
        int face = mesh_exit(m, tet, *from, rest, &fraction);
        if (face < 0 || fraction >= 1.0 || m->neighbours[tet][face] < 0) break;
        *from = v3_axpy(fraction, rest, *from);
        tet = m->neighbours[tet][face];
    }
    *from = target;
    return tet;
}

/* Does the straight way from a hit on the outer surface to x lead through tissue? *tet: the element of x. */
static bool reaches(const mesh *m, surface_hit hit, vec3 x, int *tet) {
    double weights[4];
    *tet = follow(m, hit.tet, &hit.point, x);
    mesh_barycentric(m, *tet, x, weights);
    return fmin(fmin(weights[0], weights[1]), fmin(weights[2], weights[3])) >= 0.0;
}

/* Out of the tissue, with the shaft still in it. */
static void go_beyond(const insertion_model *model, insertion_state *state) {
    needle_tip *tip = &state->tip;
    tip->phase = TIP_BEYOND;
    tip->force = tip->damping = v3(0, 0, 0);
    tip->dent = 0.0;
    tip->slip = tip->shaft_slip = 0.0;
    tip->blocked_by = NOT_BLOCKED;
    tip->end = state->needle.joints[model->needle->given.segments];
}

static void exit_tissue(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    drop_plan(state);
    if (state->tip.depth - last_contact_depth(state) > 0.5 * model->settings.contact_spacing) leave_contact(model, state, wrench);
    go_beyond(model, state);
    wrench->events |= EVENT_EXITED;
}

/* Back out of this body into the gap before it: the tip's place is again where it had left the body before. */
static void back_into_gap(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    int gap = last_gap(state);
    const stratum *left = &state->strata[gap];
    state->tip.depth = left->depth;
    state->tip.tet = left->tet;
    state->tip.nominal = left->point;
    set_beside(&state->tip, v3(0, 0, 0));
    state->stratum_count = gap;
    go_beyond(model, state);
    wrench->events |= EVENT_EXITED;
}

static void leave_contact_on_face(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    if (state->tip.depth >= last_contact_depth(state) + model->settings.contact_spacing) leave_contact(model, state, wrench);
}

static void cross_face(const insertion_model *model, insertion_state *state, int face, vec3 direction, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    int next = model->mesh->neighbours[tip->tet][face];
    if (next < 0) {
        exit_tissue(model, state, wrench);
        return;
    }
    if (model->settings.placement != PLACE_INSIDE) leave_contact_on_face(model, state, wrench);
    tip->tet = next;
    tip->nominal = v3_axpy(FACE_CLEARANCE, direction, tip->nominal);
    enter_stratum(model->mesh, state, wrench);
    plan_contact(model, state, direction, wrench);
}

/* ---- along an outer face ----------------------------------------------------------------------------------------------

   A needle is not out of the tissue as soon as its axis is: a tip that reaches an outer face at a small angle goes on along the face
   until it is out by the needle's radius. In the mesh, a point just inside the face stands for it. */

/* Does the tip go on along this outer face, which it has reached? Not where other tissue is behind it, or a membrane on it. */
static bool grazes(const insertion_model *model, const needle_tip *tip, int face, vec3 direction) {
    vec3 inward = mesh_face_normal(model->mesh, tip->tet, face);
    if (v3_dot(direction, inward) < -GRAZING || obstacle(model, tip->tet, face, -1) != NOT_BLOCKED) return false;
    return !mesh_enter(model->mesh, tip->nominal, v3_axpy(-model->needle->radius, inward, tip->nominal)).hit;
}

static void begin_grazing(const insertion_model *model, insertion_state *state, int face, vec3 direction, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    vec3 inward = mesh_face_normal(model->mesh, tip->tet, face);
    tip->tet = follow(model->mesh, tip->tet, &tip->nominal, v3_axpy(GRAZING_DEPTH, inward, tip->nominal));
    tip->beside = v3_axpy(-GRAZING_DEPTH, inward, tip->beside);
    tip->outward = v3_scale(-1.0, inward);
    plan_contact(model, state, direction, wrench);
}

/* The tip itself has moved by `part` along `direction`, and `nominal` along the face. The tip may be back in the tissue, or out of it. */
static void graze_on(const insertion_model *model, insertion_state *state, vec3 direction, double part, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    tip->beside = v3_axpy(part * v3_dot(direction, tip->outward), tip->outward, tip->beside);
    double out = v3_dot(tip->beside, tip->outward);
    if (out > model->needle->radius) {
        exit_tissue(model, state, wrench);
    } else if (out < 0.0) {
        tip->tet = follow(model->mesh, tip->tet, &tip->nominal, tip_place(tip));
        tip->beside = tip->outward = v3(0, 0, 0);
        plan_contact(model, state, direction, wrench);
    }
}

/* Cuts forward by `distance` along the unit nominal direction: contacts are left where they are due, membranes stop. */
static void cut_forward(const insertion_model *model, insertion_state *state, vec3 direction, double distance, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (isnan(tip->next_contact)) plan_contact(model, state, direction, wrench);
    for (int step = 0; step < MAX_STEPS && distance > 0.0 && tip->phase == TIP_INSIDE && tip->blocked_by == NOT_BLOCKED; step++) {
        double to_face, to_contact = tip->next_contact - tip->depth;
        vec3 way = tip_way(tip, direction);
        int face = mesh_exit(model->mesh, tip->tet, tip->nominal, way, &to_face);
        if (face < 0) return;
        double part = fmax(0.0, fmin(distance, fmin(to_face, to_contact)));
        tip->nominal = v3_axpy(part, way, tip->nominal);
        tip->depth += part;
        distance -= part;
        bool grazing = v3_norm(tip->outward) > 0.0;
        if (grazing) graze_on(model, state, direction, part, wrench);
        if (tip->phase != TIP_INSIDE) return;
        if (grazing && v3_norm(tip->outward) == 0.0) continue; /* back in the tissue: another element, perhaps */
        if (to_contact <= part) leave_contact(model, state, wrench);
        else if (to_face <= part && model->mesh->neighbours[tip->tet][face] < 0 && grazes(model, tip, face, direction))
            begin_grazing(model, state, face, direction, wrench);
        else if (to_face <= part) {
            tip->blocked_by = obstacle(model, tip->tet, face, model->mesh->neighbours[tip->tet][face]);
            tip->face = face;
            tip->entering = false;
            if (tip->blocked_by == NOT_BLOCKED) cross_face(model, state, face, way, wrench);
        }
    }
}

static void leave_tissue(needle_tip *tip, insertion_wrench *wrench) {
    *tip = (needle_tip){.phase = TIP_FREE, .tet = -1, .known_tet = -1, .blocked_by = NOT_BLOCKED, .next_contact = NAN};
    wrench->events |= EVENT_WITHDRAWN;
}

/* Draws back by `distance` along the track, taking up contact nodes on the way. */
static void draw_back(const insertion_model *model, insertion_state *state, double distance, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    tip->blocked_by = NOT_BLOCKED;
    drop_plan(state);
    while (distance > 0.0) {
        int last = state->refined.count - 1, gap = last_gap(state);
        double entry = tip_entry_depth(state);
        if (last >= 0 && state->contacts[last].depth < entry) last = -1; /* of a body before this one */
        double length = tip->depth - (last >= 0 ? state->contacts[last].depth : entry);
        if (distance >= length) {
            distance -= fmax(length, 0.0);
            if (last < 0 && gap >= 0) {
                back_into_gap(model, state, wrench);
                return;
            }
            if (last >= 0) {
                take_up_contact(model, state, wrench);
                continue;
            }
            leave_tissue(tip, wrench);
            return;
        }
        vec3 goal = last >= 0 ? state->contacts[last].track : gap >= 0 ? state->strata[gap + 1].point : state->entry;
        vec3 beside = last >= 0 ? state->contacts[last].beside : v3(0, 0, 0);
        goal = v3_sub(goal, beside);
        vec3 target = v3_axpy(distance / length, v3_sub(goal, tip->nominal), tip->nominal);
        set_beside(tip, v3_axpy(distance / length, v3_sub(beside, tip->beside), tip->beside));
        tip->tet = follow(model->mesh, tip->tet, &tip->nominal, target);
        tip->depth -= distance;
        leave_strata(state);
        return;
    }
}

/* Unit nominal direction whose image in the deformed tissue, d + gradient, is along `direction`; `direction` itself where the
   tissue is deformed beyond what linear elasticity means. How far the tissue is compressed along the needle does not count:
   what it falsifies in one tick, the slip of the next makes good. */
static vec3 pull_back(vec3 gradient, vec3 direction) {
    direction = v3_unit(direction);
    vec3 sideways = v3_axpy(-v3_dot(gradient, direction), direction, gradient);
    double square = v3_dot(sideways, sideways);
    if (!(square < MOST_SHEAR * MOST_SHEAR)) return direction;
    return v3_axpy(sqrt(1.0 - square), direction, v3_scale(-1.0, sideways));
}

/* ---- public ---------------------------------------------------------------------------------------------------------- */

bool tip_touch(const insertion_model *model, insertion_state *state, vec3 from, vec3 to, insertion_wrench *wrench) {
    surface_hit hit = mesh_enter(model->mesh, from, to);
    if (!hit.hit) return false;
    state->tip = (needle_tip){.phase = TIP_INSIDE, .tet = hit.tet, .face = hit.face, .nominal = hit.point, .direction = v3_unit(v3_sub(to, from)),
                              .known_tet = -1, .blocked_by = obstacle(model, hit.tet, hit.face, hit.tet), .entering = true,
                              .next_contact = NAN};
    state->entry = hit.point;
    state->stratum_count = 0;
    enter_stratum(model->mesh, state, wrench);
    wrench->events |= EVENT_TOUCHED;
    return true;
}

bool tip_is_below(const insertion_model *model, vec3 from, vec3 to) {
    surface_hit hit = mesh_enter(model->mesh, from, to);
    int tet;
    return hit.hit && reaches(model->mesh, hit, to, &tet);
}

void tip_glide(const insertion_model *model, insertion_state *state, vec3 inward, vec3 shift, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    vec3 goal = v3_add(tip->nominal, shift);
    surface_hit hit = mesh_enter(model->mesh, v3_axpy(-GLIDE_REACH, inward, goal), v3_axpy(GLIDE_REACH, inward, goal));
    if (!hit.hit) { /* over the edge, once the straight needle would be past the tissue: sooner, it would meet the surface again */
        vec3 axis = q_axis(state->needle.base.orientation);
        vec3 end = v3_axpy(model->needle->given.length, axis, state->needle.base.position);
        if (!tip_is_below(model, v3_axpy(-GLIDE_REACH, axis, end), end)) leave_tissue(tip, wrench);
        return;
    }
    tip->tet = hit.tet;
    tip->face = hit.face;
    tip->nominal = state->entry = hit.point;
    state->stratum_count = 0;
    enter_stratum(model->mesh, state, wrench);
    tip->blocked_by = obstacle(model, hit.tet, hit.face, hit.tet);
    tip->entering = true;
}

/* What blocks the tip lets it through. */
static void give_way(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    vec3 direction = v3_unit(needle_direction(model, state));
    wrench->events |= EVENT_PUNCTURED;
    wrench->membrane = tip->blocked_by;
    tip->blocked_by = NOT_BLOCKED;
    if (!tip->entering) {
        cross_face(model, state, tip->face, direction, wrench);
    } else { /* the tip is on the inner side already */
        tip->nominal = v3_axpy(FACE_CLEARANCE, direction, tip->nominal);
        tip->depth += FACE_CLEARANCE;
    }
}

/* How far the needle's end is beyond the point of the shaft at which the tip left the tissue, m. */
static double beyond_exit(const insertion_model *model, const insertion_state *state) {
    int last = state->refined.count - 1;
    if (last < 0) return -INFINITY;
    return model->needle->given.length - (state->contacts[last].arc + state->tip.depth - state->contacts[last].depth);
}

/* After leaving on the far side: the tip is back when the needle's end is behind the exit point, by more than a radius. Nearer, tissue
   that springs back as the tip lets go of it would take the tip in again. */
static void come_back(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    double beyond = beyond_exit(model, state);
    if (beyond > -model->needle->radius) return;
    state->tip.phase = TIP_INSIDE;
    if (isfinite(beyond)) state->tip.slip = beyond;
    wrench->events |= EVENT_REENTERED;
}

/* Where the tip enters a body: a point of the mesh, and what blocks it there. */
typedef struct {
    bool found;
    int tet, face, blocked_by;
    vec3 point;              /* m, nominal */
} entrance;

static entrance entrance_at(const insertion_model *model, surface_hit hit) {
    return (entrance){hit.hit, hit.tet, hit.face, hit.hit ? obstacle(model, hit.tet, hit.face, hit.tet) : NOT_BLOCKED, hit.point};
}

/* Into the next body, `gap` (m) after the exit. Where there is no room to note that, the needle goes on unfelt. */
static void enter_next(const insertion_model *model, insertion_state *state, const entrance *at, double gap, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (!at->found) return;
    if (state->stratum_count + 2 > MAX_STRATA) {
        wrench->events |= EVENT_FULL;
        return;
    }
    note_stratum(state, IN_A_GAP, wrench);
    tip->phase = TIP_INSIDE;
    tip->tet = at->tet;
    tip->face = at->face;
    tip->nominal = at->point;
    set_beside(tip, v3(0, 0, 0));
    tip->direction = v3_unit(needle_direction(model, state));
    tip->depth += fmax(gap, FACE_CLEARANCE);
    tip->known_tet = -1;
    tip->blocked_by = at->blocked_by;
    tip->entering = true;
    tip->next_contact = NAN;
    enter_stratum(model->mesh, state, wrench);
    wrench->events |= EVENT_TOUCHED;
}

/* Where the segment from `left`, at which the tip left a body, to `to` enters the next one. Bodies that were meshed apart may
   overlap: then the tip is in the next one as it leaves the first. */
static entrance next_body(const insertion_model *model, vec3 left, vec3 to) {
    vec3 direction = v3_unit(v3_sub(to, left)), beyond = v3_axpy(2.0 * FACE_CLEARANCE, direction, left);
    entrance overlap = entrance_at(model, mesh_enter(model->mesh, v3_axpy(-OVERLAP, direction, left), left));
    surface_hit before = {.hit = overlap.found, .tet = overlap.tet, .point = overlap.point};
    if (before.hit && reaches(model->mesh, before, beyond, &overlap.tet)) {
        overlap.point = beyond;
        return overlap;
    }
    return entrance_at(model, mesh_enter(model->mesh, v3_axpy(-FACE_CLEARANCE, direction, left), to));
}

/* The tip has left the tissue in this tick. Bodies that touch pass on how they are displaced: what lies between the nominal
   point where the tip left and its place in space is entered at once. */
static void enter_what_touches(const insertion_model *model, insertion_state *state, vec3 direction, insertion_wrench *wrench) {
    vec3 left = state->tip.nominal, way = v3_sub(state->tip.end, left);
    if (v3_dot(way, direction) < 2.0 * FACE_CLEARANCE) way = v3_scale(2.0 * FACE_CLEARANCE, direction);
    entrance at = next_body(model, left, v3_add(left, way));
    enter_next(model, state, &at, v3_norm(v3_sub(at.point, left)), wrench);
}

void tip_puncture(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (tip->phase != TIP_INSIDE || tip->blocked_by == NOT_BLOCKED || tip->slip <= 0.0) return;
    tip->slip = 0.0;
    give_way(model, state, wrench);
    if (tip->phase == TIP_BEYOND) enter_what_touches(model, state, v3_unit(needle_direction(model, state)), wrench);
}

/* The track's direction at the tip: a running mean over about one diameter of the needle. `way` is the piece that was just cut. */
static void follow_track(const insertion_model *model, needle_tip *tip, vec3 way) {
    double length = v3_norm(way);
    if (length == 0.0) return;
    vec3 change = v3_sub(v3_scale(1.0 / length, way), tip->direction);
    tip->direction = v3_unit(v3_axpy(-expm1(-0.5 * length / model->needle->radius), change, tip->direction));
}

/* The end of a needle that is out on the far side may meet other tissue as it goes on. */
static void look_for_next(const insertion_model *model, insertion_state *state, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    vec3 before = tip->end, now = state->needle.joints[model->needle->given.segments];
    tip->end = now;
    if (v3_dot(v3_sub(now, before), needle_direction(model, state)) <= 0.0) return;
    entrance at = entrance_at(model, mesh_enter(model->mesh, before, now));
    enter_next(model, state, &at, beyond_exit(model, state) - v3_norm(v3_sub(now, at.point)), wrench);
}

void tip_move(const insertion_model *model, insertion_state *state, vec3 track_gradient, insertion_wrench *wrench) {
    needle_tip *tip = &state->tip;
    if (tip->phase == TIP_BEYOND) come_back(model, state, wrench);
    if (tip->phase == TIP_BEYOND) look_for_next(model, state, wrench);
    if (tip->phase != TIP_INSIDE) return;
    vec3 before = tip_place(tip);
    if (tip->slip > 0.0) {
        vec3 direction = pull_back(track_gradient, needle_direction(model, state));
        cut_forward(model, state, direction, tip->slip, wrench);
        follow_track(model, tip, v3_sub(tip_place(tip), before));
        if (tip->phase == TIP_BEYOND) enter_what_touches(model, state, direction, wrench);
    } else if (tip->slip < 0.0) {
        draw_back(model, state, -tip->slip, wrench);
        follow_track(model, tip, v3_sub(before, tip_place(tip)));
    }
    tip->slip = 0.0;
    while (tip->phase == TIP_INSIDE && contacts_passed(state) > 0
           && state->contacts[contacts_passed(state) - 1].arc > model->needle->given.length) {
        drop_plan(state);
        take_up_contact(model, state, wrench);
    }
}

void tip_engage(const insertion_model *model, insertion_state *state) {
    insertion_wrench ignored = {0};
    vec3 base = state->needle.joints[0], end = state->needle.joints[model->needle->given.segments];
    if (!tip_touch(model, state, base, end, &ignored)) return;
    vec3 direction = v3_unit(v3_sub(end, base));
    double whole = v3_norm(v3_sub(end, state->entry));
    for (int step = 0; step < MAX_STEPS && state->tip.phase == TIP_INSIDE && state->tip.depth < whole; step++) {
        if (state->tip.blocked_by != NOT_BLOCKED) give_way(model, state, &ignored); /* what the needle already lies in did so before */
        cut_forward(model, state, direction, whole - state->tip.depth, &ignored);
        if (state->tip.phase != TIP_BEYOND) continue;
        vec3 left = state->tip.nominal;
        entrance at = next_body(model, left, end);
        enter_next(model, state, &at, v3_dot(v3_sub(at.point, left), direction), &ignored);
    }
    for (int i = 0; i < state->refined.count; i++)
        state->contacts[i].arc = v3_dot(v3_sub(state->contacts[i].track, base), direction);
}
