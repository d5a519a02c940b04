#include "insertion/laws/creep.h"

#include <string.h>

#include "insertion/laws/along_track.h"
#include "insertion/laws/creep_kernels.h"
#include "insertion/laws/stiffening.h"

static const double TOGETHER = 1e-3; /* m: residual loads closer together than this are merged. Cost limit */
static const double NOTICEABLE = 1e-3; /* N: new residual loads are worth a request to the worker once they add up to this. Cost limit: below what a hand
                                          feels */
static const double NEGLIGIBLE = 1e-9; /* N: residual loads smaller than this are dropped. Rounding tolerance */
static const double ALL_OF_IT = 1e-9; /* fraction: part of a share's length that may remain unassigned. Rounding tolerance */

static const vec3 ZERO = {0, 0, 0};
static const remembered_forces NOTHING = {{0, 0, 0}, 0, 0};

/* to += factor * from */
static void add_part(double factor, const remembered_forces *from, remembered_forces *to) {
    to->load = v3_axpy(factor, from->load, to->load);
    to->along += factor * from->along;
    to->twist += factor * from->twist;
}

/* Computes the weighted sum of the terms. */
static void add_up(int count, const double *weights, const remembered_forces *terms, remembered_forces *sum) {
    *sum = NOTHING;
    for (int k = 0; k < count; k++) add_part(weights[k], &terms[k], sum);
}

static double modulus_in(const insertion_model *model, int tet) { return model->materials[model->mesh->region[tet]].youngs_modulus; }

/* ---- loads that nothing holds ------------------------------------------------------------------------------------------ */

static double size_of_terms(const creep_series *series, const vec3 *terms) {
    double size = 0.0;
    for (int k = 0; k < series->count; k++) size += series->compliance[k] * v3_norm(terms[k]);
    return size;
}

/* Returns the index of the residual load closest to x, or -1 if there is none. */
static int closest_residual(const residual_loads *residual, vec3 x, double *distance) {
    int closest = -1;
    *distance = INFINITY;
    for (int i = 0; i < residual->count; i++) {
        double away = v3_norm(v3_sub(residual->loads[i].at, x));
        if (away < *distance) *distance = away, closest = i;
    }
    return closest;
}

/* Extends a piece of shaft to include another, nearly parallel one. */
static void extend_piece(const shaft_piece *other, shaft_piece *piece) {
    const double ends[2] = {other->from, other->to};
    for (int i = 0; i < 2; i++) {
        vec3 end = v3_axpy(ends[i] - other->depth, other->direction, other->place);
        double depth = piece->depth + v3_dot(piece->direction, v3_sub(end, piece->place));
        piece->from = fmin(piece->from, depth);
        piece->to = fmax(piece->to, depth);
    }
}

/* Adds the fraction `part` of a share's load to the residual loads, where the share's load acts, decayed to the end of the step. The load is attributed to that
   fraction of the share's piece of shaft, at its deep end. `decay` is NULL between two steps. */
static void deposit_load(const insertion_model *model, tissue_memory *memory, const share_memory *share, double part, const double *decay) {
    const creep_series *series = &model->creep;
    residual_loads *residual = &memory->residual;
    vec3 load[MAX_RELAXATION];
    for (int k = 0; k < series->count; k++) load[k] = v3_scale(part, share->terms[k].load);
    double distance, size = size_of_terms(series, load);
    if (size == 0.0) return;
    shaft_piece shaft = share->shaft;
    shaft.from = shaft.to - part * (shaft.to - shaft.from);
    int i = closest_residual(residual, share->at, &distance);
    if (i < 0 || (distance > TOGETHER && residual->count < MAX_RESIDUAL_LOADS)) {
        i = residual->count++;
        residual->loads[i] = (residual_load){.tet = share->tet, .at = share->at, .modulus = share->modulus, .shaft = shaft};
        mesh_barycentric(model->mesh, share->tet, share->at, residual->loads[i].weights);
    } else if (distance <= TOGETHER) {
        extend_piece(&shaft, &residual->loads[i].shaft);
    }
    for (int k = 0; k < series->count; k++) residual->loads[i].load[k] = v3_axpy(decay ? decay[k] : 1.0, load[k], residual->loads[i].load[k]);
    memory->residual_added += size;
    memory->residual_growing = true;
}

static void fade_residuals(const creep_series *series, const double *decay, residual_loads *residual) {
    int kept = 0;
    for (int i = 0; i < residual->count; i++) {
        residual_load *load = &residual->loads[i];
        for (int k = 0; k < series->count; k++) load->load[k] = v3_scale(decay[k], load->load[k]);
        if (size_of_terms(series, load->load) > NEGLIGIBLE) residual->loads[kept++] = *load;
    }
    residual->count = kept;
}

bool creep_has_new_residuals(const tissue_memory *memory) {
    return memory->residual_added > NOTICEABLE || (memory->residual_added > 0.0 && !memory->residual_growing);
}

/* ---- one step ---------------------------------------------------------------------------------------------------------- */

void creep_begin(const tick_input *tick, insertion_state *state, creep_step *creep) {
    const creep_series *series = &tick->model->creep;
    tissue_memory *memory = &state->memory;
    creep->yield = 1.0;
    if (series->count == 0) return;
    memory->time += tick->dt;
    memory->residual_growing = false;
    for (int k = 0; k < series->count; k++) {
        creep->decay[k] = exp(-tick->dt / series->time[k]);
        creep->residual[k] = exp(-(memory->time - tick->snapshot->residual_time) / series->time[k]);
        creep->yield += series->compliance[k] * (1.0 - creep->decay[k]);
    }
    for (int k = 0; k < series->count; k++) creep->weight[k] = series->compliance[k] * creep->decay[k] / creep->yield;
    fade_residuals(series, creep->decay, &memory->residual);
    memory->residual.time = memory->time;
}

/* Returns the tissue's memory at a point, which must not be at a guide. */
static const share_memory *share_of(const insertion_state *state, const contact_points *points, int point) { return &state->memory.shares[point - points->guided]; }

/* Returns a share without memory at the point's current position. Like the tip's local compliance, the tip's share extends one radius beyond the tip. */
static share_memory empty_share(const tick_input *tick, const insertion_state *state, const contact_point *p) {
    if (p->kind == POINT_TIP) {
        shaft_share share = {p->share.from, p->share.to + tick->model->needle->radius};
        int tet = state->tip.place.tet;
        return (share_memory){.shaft = shaft_piece_of_tip(state, share), .tet = tet, .at = state->tip.place.nominal, .modulus = modulus_in(tick->model, tet)};
    }
    const added_node *node = &state->refined.nodes[p->handle];
    return (share_memory){.shaft = shaft_piece_of_contact(state, p->handle, p->share), .tet = node->tet, .at = node->position, .modulus = modulus_in(tick->model, node->tet)};
}

/* Returns how many shares, counted from the base, have the same borders as in the last step. Does not count the last share, which ends at the tip. */
static int count_kept(const insertion_state *state, const contact_points *points) {
    const tissue_memory *memory = &state->memory;
    const contact_point *now_at = &points->list[points->guided];
    int now = points->count - points->guided, most = (now < memory->count ? now : memory->count) - 1, kept = 0;
    while (kept < most && memory->shares[kept].shaft.from == now_at[kept].share.from && memory->shares[kept].shaft.to == now_at[kept].share.to) kept++;
    return kept;
}

/* Returns how far (m) the tip has moved since the last step. */
static double tip_way_since(const insertion_state *state, const contact_points *points) {
    const tissue_memory *memory = &state->memory;
    return memory->tip && points->tip ? v3_norm(v3_sub(state->tip.place.nominal, memory->shares[memory->count - 1].at)) : 0.0;
}

/* A tip that slides along the surface has no track. As it moves by about one diameter, its memory turns into residual load on the tissue it leaves; the tissue
   it reaches remembers nothing. */
static void glide(const tick_input *tick, insertion_state *state, const creep_step *creep) {
    tissue_memory *memory = &state->memory;
    share_memory *share = &memory->shares[0];
    double part = -expm1(-0.5 * creep->tip_moved / tick->model->needle->radius);
    deposit_load(tick->model, memory, share, part, creep->decay);
    for (int k = 0; k < tick->model->creep.count; k++) {
        remembered_forces *term = &share->terms[k];
        term->load = v3_scale(1.0 - part, term->load);
        term->along *= 1.0 - part;
    }
}

/* Distributes a share's memory over the new shares that overlap it, searching from share `first`. The rest becomes residual load. Returns the first overlapping
   share. */
static int transfer_memory(const insertion_model *model, tissue_memory *memory, const share_memory *before, int first, const double *decay) {
    double length = before->shaft.to - before->shaft.from, rest = 1.0;
    while (first < memory->count && memory->shares[first].shaft.to <= before->shaft.from) first++;
    for (int k = first; k < memory->count && memory->shares[k].shaft.from < before->shaft.to; k++) {
        share_memory *now = &memory->shares[k];
        double part = (fmin(now->shaft.to, before->shaft.to) - fmax(now->shaft.from, before->shaft.from)) / length;
        for (int t = 0; t < model->creep.count; t++) add_part(part, &before->terms[t], &now->terms[t]);
        rest -= part;
    }
    if (rest > ALL_OF_IT) deposit_load(model, memory, before, rest, decay);
    return first;
}

/* Memory belongs to the tissue and stays where it is. When the borders between shares move, the memory between the old and new borders therefore passes to
   another share. Within a share, memory is spread evenly over the length. */
void creep_divide(const tick_input *tick, insertion_state *state, const contact_points *points, creep_step *creep) {
    tissue_memory *memory = &state->memory;
    if (tick->model->creep.count == 0) return;
    creep->tip_moved = tip_way_since(state, points);
    if (points->tip && memory->count == 1 && state->tip.place.depth == 0.0 && creep->tip_moved > 0.0) glide(tick, state, creep);
    int first = creep->kept = count_kept(state, points), count = creep->before_count = memory->count - first;
    const share_memory *before = memcpy(creep->before, &memory->shares[first], (size_t)count * sizeof *before);
    creep->before_tip = memory->tip;
    memory->count = points->count - points->guided;
    memory->tip = points->tip;
    for (int k = first; k < memory->count; k++) memory->shares[k] = empty_share(tick, state, &points->list[points->guided + k]);
    for (int i = 0; i < count; i++) first = transfer_memory(tick->model, memory, &before[i], first, creep->decay);
}

void creep_deposit_all(const insertion_model *model, tissue_memory *memory, const double *decay) {
    for (int i = 0; i < memory->count; i++) deposit_load(model, memory, &memory->shares[i], 1.0, decay);
    memory->count = 0;
    memory->tip = false;
    memset(memory->face, 0, sizeof memory->face);
}

/* Stores an element's new modulus and returns the factor by which it has changed. */
static double soften(const insertion_model *model, int tet, double *modulus) {
    double before = *modulus;
    *modulus = modulus_in(model, tet);
    return *modulus / before;
}

void creep_soften(const insertion_model *model, tissue_memory *memory) {
    const creep_series *series = &model->creep;
    for (int i = 0; i < memory->count && series->count > 0; i++) {
        share_memory *share = &memory->shares[i];
        double factor = soften(model, share->tet, &share->modulus);
        for (int k = 0; k < series->count; k++) {
            remembered_forces *term = &share->terms[k];
            *term = (remembered_forces){v3_scale(factor, term->load), factor * term->along, factor * term->twist};
            if (memory->tip && i + 1 == memory->count) memory->face[k] *= factor;
        }
    }
    for (int i = 0; i < memory->residual.count; i++) {
        residual_load *residual = &memory->residual.loads[i];
        double factor = soften(model, residual->tet, &residual->modulus);
        for (int k = 0; k < series->count; k++) residual->load[k] = v3_scale(factor, residual->load[k]);
        memory->residual_added += fabs(factor - 1.0) * size_of_terms(series, residual->load); /* the worker needs the new loads */
    }
}

void creep_forget(tissue_memory *memory) {
    memory->count = memory->residual.count = 0;
    memory->tip = false;
    memset(memory->face, 0, sizeof memory->face);
    memory->since = memory->time;
}

/* ---- displacements ----------------------------------------------------------------------------------------------------- */

/* The field around the end face extends over about one diameter, so an advancing tip reaches tissue with less memory. The memory fades over one diameter plus
   the depth of the remembered dent; over one diameter alone, tissue that springs back on a cutting tip could do more work than the cutting. */
static void fade_face(const tick_input *tick, insertion_state *state, const creep_step *creep, double yielding) {
    const creep_series *series = &tick->model->creep;
    double *face = state->memory.face, dent = 0.0, moved = creep->tip_moved;
    if (moved == 0.0) return;
    for (int k = 0; k < series->count; k++) dent += yielding * series->compliance[k] * fabs(face[k]);
    double fading = exp(-moved / (2.0 * tick->model->needle->radius + dent));
    for (int k = 0; k < series->count; k++) face[k] *= fading;
}

/* The tip's share extends one radius beyond the tip, but the shaft does not. Returns the fraction of `along`, the load on a shaft as long as the share, that
   this shorter shaft bears. */
static double shaft_part(const tick_input *tick, const insertion_state *state) {
    const share_memory *share = &state->memory.shares[state->memory.count - 1];
    return 1.0 - tick->model->needle->radius / (share->shaft.to - share->shaft.from);
}

/* Computes how far the remembered loads displace the tissue at each point. */
static void find_moved(const tick_input *tick, const contact_points *points, const tissue_step *tissue, creep_step *creep) {
    _Alignas(CACHE_LINE) slot_vectors load = {{0}}, moved = {{0}};
    slot_vectors by_beyond;
    const remembered_forces *by = creep->remembered;
    int tip = points->count - 1, contacts_end = points->count - points->tip, slots_end = 0;
    for (int i = points->guided; i < contacts_end; i++) {
        int slot = points->list[i].handle;
        load[0][slot] = by[i].load.x;
        load[1][slot] = by[i].load.y;
        load[2][slot] = by[i].load.z;
        if (slot >= slots_end) slots_end = slot + 1;
    }
    for (int i = points->guided; i < contacts_end; i++)
        slots_displace(&tick->snapshot->between_contacts[points->list[i].handle], points->list[i].handle, slots_end, load, moved, by_beyond);
    for (int i = points->guided; i < contacts_end; i++) {
        int slot = points->list[i].handle;
        creep->moved[i] = v3_scale(creep->yield, v3(moved[0][slot] + by_beyond[0][slot], moved[1][slot] + by_beyond[1][slot], moved[2][slot] + by_beyond[2][slot]));
    }
    if (!points->tip) return;
    creep->moved[tip] = m3_apply(&tissue->tip_row[tip], by[tip].load); /* tip_row already includes the yield */
    for (int i = points->guided; i < tip; i++) {
        creep->moved[tip] = v3_add(creep->moved[tip], m3_apply(&tissue->tip_row[i], by[i].load));
        creep->moved[i] = v3_add(creep->moved[i], m3_apply_transposed(&tissue->tip_row[i], by[tip].load));
    }
}

/* Returns the traction (N/m) along the needle that is equivalent to a share's memory. */
static double traction_of(const tick_input *tick, const creep_step *creep, const share_memory *share) {
    double sum = 0.0;
    for (int k = 0; k < tick->model->creep.count; k++) sum += creep->weight[k] * share->terms[k].along;
    return creep->yield * sum / (share->shaft.to - share->shaft.from);
}

static double traction_at(const tick_input *tick, const creep_step *creep, int count, const share_memory *shares, double depth) {
    int i = 0;
    while (i + 1 < count && shares[i].shaft.to < depth) i++;
    return count > 0 ? traction_of(tick, creep, &shares[i]) : 0.0;
}

double creep_traction_of(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep,
                         int i) { return tick->model->creep.count > 0 ? traction_of(tick, creep, share_of(state, points, i)) : 0.0; }

/* When a share's borders move, the mean shear that it remembers changes. This shifts the shaft's origin so that the change does not move the shaft, as in
   keep_shear. */
static void keep_remembered_shear(const tick_input *tick, insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                                  const stiffening_step *stiffening) {
    for (int i = points->guided + creep->kept; i < points->count; i++) {
        const contact_point *p = &points->list[i];
        bool tip = p->kind == POINT_TIP;
        double depth = tip ? state->tip.place.depth : state->contacts[p->handle].depth;
        double before = traction_at(tick, creep, creep->before_count, creep->before, depth);
        double length = p->share.to - p->share.from, now = traction_of(tick, creep, share_of(state, points, i));
        double held = (tip ? state->tip.shaft.traction : state->contacts[p->handle].shaft.traction) + now;
        double lead = (tissue->axial[i + tip] + stiffening_slope(stiffening, i, length * held)) * length * (now - before);
        if (tip) shift_tip_shaft(state, lead);
        else state->contacts[p->handle].shaft.origin += lead;
    }
}

void creep_prepare(const tick_input *tick, insertion_state *state, const contact_points *points, tissue_step *tissue, creep_step *creep,
                   const stiffening_step *stiffening) {
    const creep_series *series = &tick->model->creep;
    if (series->count == 0) return;
    int tip = points->count - 1;
    if (points->tip) fade_face(tick, state, creep, tissue->axial[tip]);
    keep_remembered_shear(tick, state, points, tissue, creep, stiffening);
    for (int i = points->guided; i < points->count; i++) {
        add_up(series->count, creep->weight, share_of(state, points, i)->terms, &creep->remembered[i]);
        tissue->lateral[i].least *= creep->yield;
        tissue->lateral[i].more *= creep->yield;
        tissue->axial[i] *= creep->yield;
    }
    creep->face = 0.0;
    if (points->tip) {
        for (int k = 0; k < series->count; k++) creep->face += creep->weight[k] * state->memory.face[k];
        creep->remembered[tip].along *= shaft_part(tick, state);
        creep->remembered[tip].twist *= shaft_part(tick, state);
        tissue->axial[tip + 1] *= creep->yield;
    }
    find_moved(tick, points, tissue, creep);
}

/* Multiplies the local compliance by the remembered force, as in add_local_compliance. The extra lateral compliance near the surface does not stand for tissue,
   so it does not creep. */
void creep_shift_gaps(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                      contact_problem *problem) {
    if (tick->model->creep.count == 0) return;
    for (int i = points->guided; i < problem->count; i++) {
        bool tip = points->list[i].kind == POINT_TIP;
        const remembered_forces *by = &creep->remembered[i];
        const track_shares at = along_track(state, points, tissue, i);
        vec3 track = point_track(state, &points->list[i]), across = v3_axpy(-v3_dot(track, by->load), track, by->load);
        vec3 aside = v3_axpy(tissue->lateral[i].more * v3_dot(tissue->lateral[i].easy, by->load), tissue->lateral[i].easy, v3_scale(tissue->lateral[i].least, across));
        double shaft = tissue->axial[i + tip], face = tip ? tissue->axial[i] : 0.0;
        const mat3 *frame = &points->list[i].at.frame;
        vec3 around_shaft = m3_apply_transposed(frame, v3_axpy(shaft * by->along, track, v3_scale(at.on_shaft[0], aside)));
        vec3 at_face = m3_apply_transposed(frame, v3_axpy(face * creep->face, track, v3_scale(face * at.on_face[0], across)));
        const double shifts[2][4] = {{around_shaft.x, around_shaft.y, around_shaft.z, around_shaft.z}, {at_face.x, at_face.y, at_face.z, 0.0}};
        for (int a = 0; a < at.count; a++) problem->gap[at.row[a]] -= at.on_shaft[a] * shifts[0][a] + at.on_face[a] * shifts[1][a];
    }
}

double creep_dent(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep) {
    if (tick->model->creep.count == 0) return 0.0;
    int tip = points->count - 1;
    vec3 along = state->tip.place.direction;
    return v3_dot(along, creep->moved[tip]) + tissue->axial[tip] * creep->face;
}

static bool has_residuals(const tick_input *tick, const insertion_state *state) { return tick->snapshot->has_residuals && tick->snapshot->residual_time > state->memory.since; }

bool creep_free_is_zero(const tick_input *tick, const insertion_state *state) { return !tick->snapshot->loaded && !has_residuals(tick, state); }

vec3 creep_free(const tick_input *tick, const insertion_state *state, const creep_step *creep, int handle) {
    const compliance_snapshot *snapshot = tick->snapshot;
    vec3 u = snapshot->u_free[handle];
    if (!has_residuals(tick, state)) return u;
    for (int k = 0; k < tick->model->creep.count; k++)
        u = v3_axpy(tick->model->creep.compliance[k] * creep->residual[k], snapshot->u_residual[k][handle], u);
    return u;
}

vec3 creep_unresolved(const tick_input *tick, const insertion_state *state, const creep_step *creep, double from, double to) {
    const compliance_snapshot *snapshot = tick->snapshot;
    vec3 u = unresolved_mean(&snapshot->unresolved, from, to);
    if (!has_residuals(tick, state)) return u;
    for (int k = 0; k < tick->model->creep.count; k++)
        u = v3_axpy(tick->model->creep.compliance[k] * creep->residual[k], unresolved_mean(&snapshot->unresolved_residual[k], from, to), u);
    return u;
}

vec3 creep_unresolved_at_entry(const tick_input *tick, const insertion_state *state, const creep_step *creep) {
    const unresolved_shift *shift = &tick->snapshot->unresolved;
    return creep_unresolved(tick, state, creep, shift->start, shift->start + shift->step);
}

vec3 creep_free_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]) {
    vec3 u = ZERO;
    for (int c = 0; c < 4; c++) u = v3_axpy(weights[c], creep_free(tick, state, creep, handles[c]), u);
    return u;
}

/* ---- memory ------------------------------------------------------------------------------------------------------------ */

static void follow(const creep_series *series, const double *decay, remembered_forces now, remembered_forces *terms) {
    for (int k = 0; k < series->count; k++) {
        remembered_forces faded = NOTHING;
        add_part(decay[k], &terms[k], &faded);
        add_part(1.0 - decay[k], &now, &faded);
        terms[k] = faded;
    }
}

static void follow_face(const creep_series *series, const double *decay, double force, double *terms) {
    for (int k = 0; k < series->count; k++) terms[k] = decay[k] * terms[k] + (1.0 - decay[k]) * force;
}

void creep_remember(const tick_input *tick, insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep) {
    const creep_series *series = &tick->model->creep;
    const double *decay = creep->decay;
    if (series->count == 0) return;
    for (int i = points->guided; i < points->count; i++) {
        bool tip = points->list[i].kind == POINT_TIP;
        vec3 force = point_force(state, &points->list[i]);
        double along = v3_dot(force, point_track(state, &points->list[i])), face = tip ? force_on_face(state, points, tissue) : 0.0;
        if (tip) along = (along - face) / shaft_part(tick, state);
        double torque = tip ? state->tip.shaft.roll.torque / shaft_part(tick, state) : state->contacts[points->list[i].handle].shaft.roll.torque;
        remembered_forces now = {tip ? tip_load(&state->tip) : force, along, torque};
        follow(series, decay, now, state->memory.shares[i - points->guided].terms);
        if (tip) follow_face(series, decay, face + v3_dot(state->tip.dent.damping, state->tip.place.direction), state->memory.face);
    }
}

double creep_twist(const tick_input *tick, const creep_step *creep, int i) {
    return tick->model->creep.count > 0 ? creep->remembered[i].twist : 0.0;
}

vec3 creep_load(const insertion_model *model, const tissue_memory *memory, int i) {
    vec3 sum = ZERO;
    for (int k = 0; k < model->creep.count && i < memory->count; k++) sum = v3_axpy(model->creep.compliance[k], memory->shares[i].terms[k].load, sum);
    return sum;
}

vec3 creep_tip_load(const insertion_model *model, const tissue_memory *memory) {
    return memory->tip ? creep_load(model, memory, memory->count - 1) : ZERO;
}

vec3 creep_residual_load(const insertion_model *model, const residual_load *residual) {
    vec3 sum = ZERO;
    for (int k = 0; k < model->creep.count; k++) sum = v3_axpy(model->creep.compliance[k], residual->load[k], sum);
    return sum;
}

double creep_sum(const tissue_memory *memory) {
    vec3 sum = ZERO;
    double along = memory->time;
    for (int k = 0; k < MAX_RELAXATION; k++) {
        for (int i = 0; i < memory->count; i++) {
            const remembered_forces *term = &memory->shares[i].terms[k];
            sum = v3_add(sum, term->load);
            along += term->along + term->twist;
        }
        for (int i = 0; i < memory->residual.count; i++) sum = v3_add(sum, memory->residual.loads[i].load[k]);
        along += memory->face[k];
    }
    return sum.x + sum.y + sum.z + along;
}
