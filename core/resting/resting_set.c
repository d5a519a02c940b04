#include "resting/resting_set.h"

#include <stdlib.h>
#include <string.h>

#include "snapshot/free_displacement.h"

enum { AT_ONCE = 6 };
enum { MOST_SWEEPS = 500 }; /* sweeps: maximum number of Gauss-Seidel sweeps over a needle's points. Cost limit */
enum { MOST_ROUNDS = 20 }; /* rounds: maximum number of passes over the resting needles between two changes of the loads. Cost limit */
static const double ENOUGH = 1e-7; /* N: a force may exceed its bound by this much. Rounding tolerance */
static const double YIELDING = 1e-3; /* N/m: where a slip changes the force by less than this per metre, slipping would not relieve the force. Rounding
                                        tolerance */

static void forget_columns(resting_set *s) {
    for (int i = 0; i < MAX_NEEDLES; i++) {
        free(s->columns[i]);
        s->columns[i] = NULL;
        s->columns_known[i] = 0;
    }
}

static void forget_lacks(resting_set *s) {
    for (int i = 0; i < MAX_NEEDLES; i++)
        for (int n = 0; n < MAX_NEEDLES; n++) unresolved_cache_free(&s->caches[i][n]);
    s->cached_at = s->changes;
}

void resting_set_free(resting_set *s) {
    forget_columns(s);
    forget_lacks(s);
    free(s->force);
    free(s->move);
    free(s->load);
    free(s->nodes);
    free(s->nodal);
    free(s->aside);
    free(s->aside_move);
    s->force = s->move = s->load = s->aside = s->aside_move = NULL;
    s->nodes = NULL;
    s->nodal = NULL;
    s->count = s->load_room = 0;
}

/* ---- loads ----------------------------------------------------------------------------------------------------------------- */

static bool make_room(resting_set *s, int count) {
    if (count <= s->load_room) return true;
    free(s->nodes);
    free(s->nodal);
    s->nodes = malloc((size_t)count * sizeof *s->nodes);
    s->nodal = malloc((size_t)count * sizeof *s->nodal);
    s->load_room = s->nodes && s->nodal ? count : 0;
    return s->load_room > 0;
}

/* Computes how far held needles displace the rows of a resting one (m), counting only what the mesh does not resolve. */
static trocar_status find_displaced(resting_set *s, int index, const other_loads *held, double *displacement, bool *any, trocar_error *why) {
    const resting_needle *r = s->needles[index];
    vec3 at[MAX_LOADS] = {{0, 0, 0}};
    for (int n = 0; n < held->count; n++)
        for (int j = 0; j < held->of[n]->count; j++) {
            const tissue_load *load = &held->of[n]->loads[j];
            const mat3 *lacks;
            trocar_status status = unresolved_cache_find(&s->caches[index][n], s->pairs, r, j, &load->shaft, &lacks, why);
            if (status != TROCAR_OK) return status;
            for (int i = 0; i < r->places.count && lacks; i++) at[i] = v3_add(at[i], m3_apply(&lacks[i], load->force));
            *any = *any || lacks;
        }
    for (int u = 0; u < r->unknown_count; u++) {
        int i = resting_place(r, u);
        displacement[u] = i < 0 ? 0.0 : v3_dot(r->rows[u].direction, at[i]);
    }
    return TROCAR_OK;
}

static trocar_status respond_aside(resting_set *s, const other_loads *held, trocar_error *why) {
    memset(s->aside, 0, (size_t)inverse_attached_rows(s->inverse) * sizeof *s->aside);
    memset(s->aside_move, 0, (size_t)inverse_attached_motions(s->inverse) * sizeof *s->aside_move);
    bool before = s->any_aside;
    if (s->cached_at != s->changes) forget_lacks(s);
    s->any_aside = false;
    for (int i = 0; i < s->count && s->pairs; i++) {
        trocar_status status = find_displaced(s, i, held, s->force + s->row[i], &s->any_aside, why);
        if (status != TROCAR_OK) return status;
    }
    if (s->any_aside) inverse_attached_displaced(s->inverse, s->force, s->aside, s->aside_move);
    for (int i = 0; i < s->count; i++) memcpy(s->needles[i]->aside, s->aside + s->row[i], (size_t)s->needles[i]->unknown_count * sizeof *s->aside);
    s->any_aside = s->any_aside || before; /* stay true for one more call, so that the last displacement's disappearance is passed on */
    return TROCAR_OK;
}

/* Computes how all resting needles respond to the loads of held needles and the probe. */
static trocar_status respond(resting_set *s, const other_loads *held, trocar_error *why) {
    const mesh *m = inverse_tissue(s->inverse)->mesh;
    if (!make_room(s, 1 + loads_most_nodes(held))) return fail(why, TROCAR_NO_MEMORY, "no memory for the loads of held needles");
    trocar_status status = respond_aside(s, held, why);
    if (status != TROCAR_OK) return status;
    int count = loads_on_nodes(m, held, s->nodes, s->nodal);
    return inverse_attached_response(s->inverse, &(nodal_forces){count, s->nodes, s->nodal}, s->force, s->move, why);
}

static void take_load(resting_set *s) {
    for (int i = 0; i < s->count; i++) {
        const resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) s->load[s->row[i] + u] = r->free_force[u] + r->beside[u] + r->aside[u] + s->fading * r->fading[u];
    }
    s->shifts++;
}

void resting_set_before_release(resting_set *s) {
    for (int i = 0; i < s->count; i++) {
        resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) r->fading[u] = s->fading * r->fading[u] + r->force[u] + r->beside[u];
    }
}

void resting_set_after_release(resting_set *s) {
    for (int i = 0; i < s->count; i++) {
        resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) r->fading[u] -= r->force[u] + r->beside[u];
    }
    s->fading = 1.0;
    take_load(s);
}

bool resting_set_fade(resting_set *s, double part) {
    if (part == s->fading) return false;
    s->fading = part;
    take_load(s);
    return true;
}

/* Computes the compliance between a needle and the earlier ones that the mesh does not resolve. The attachments need it. */
static trocar_status find_mutual(const resting_set *s, int index, double **compliance, trocar_error *why) {
    const resting_needle *r = s->needles[index];
    *compliance = NULL;
    if (!s->pairs || index == 0) return TROCAR_OK;
    *compliance = malloc((size_t)r->unknown_count * (size_t)s->row[index] * sizeof **compliance);
    if (!*compliance) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    trocar_status status = TROCAR_OK;
    for (int j = 0; j < index && status == TROCAR_OK; j++)
        status = resting_mutual(s->pairs, r, s->needles[j], *compliance + s->row[j], s->row[index], why);
    return status;
}

trocar_status resting_set_attach(resting_set *s, int count, resting_needle *const *needles, trocar_error *why) {
    attachment things[MAX_NEEDLES];
    double *mutual[MAX_NEEDLES] = {NULL};
    trocar_status status = TROCAR_OK;
    int rows = 0, motions = 0;
    forget_columns(s);
    s->slips_left = 0;
    s->changes++;
    s->shifts++;
    s->count = count;
    for (int i = 0; i < count; i++) {
        s->needles[i] = needles[i];
        things[i] = resting_attachment(needles[i]);
        s->row[i] = rows;
        s->motion[i] = motions;
        if (status == TROCAR_OK) status = find_mutual(s, i, &mutual[i], why);
        things[i].mutual = mutual[i];
        things[i].mutual_ld = rows;
        rows += things[i].row_count;
        motions += things[i].motion_count;
    }
    free(s->force);
    free(s->move);
    free(s->load);
    free(s->aside);
    free(s->aside_move);
    s->aside = calloc((size_t)rows + 1, sizeof *s->aside);
    s->aside_move = calloc((size_t)motions + 1, sizeof *s->aside_move);
    s->force = malloc((size_t)(rows + 1) * sizeof *s->force);
    s->move = malloc((size_t)(motions + 1) * sizeof *s->move);
    s->load = malloc((size_t)(rows + 1) * sizeof *s->load);
    if (status == TROCAR_OK) status = inverse_attach(s->inverse, count, things, why);
    for (int i = 0; i < count; i++) free(mutual[i]);
    if (status == TROCAR_OK && !(s->force && s->move && s->load && s->aside && s->aside_move)) status = fail(why, TROCAR_NO_MEMORY, "no memory for %d resting needles", count);
    if (status == TROCAR_OK) take_load(s);
    else s->count = 0;
    return status;
}

trocar_status resting_set_change(resting_set *s, int count, resting_needle *const *needles, const other_loads *held, trocar_error *why) {
    trocar_status status = resting_set_attach(s, count, needles, why);
    if (status == TROCAR_OK) status = respond(s, held, why);
    for (int i = 0; i < count && status == TROCAR_OK; i++) { /* subtract how the new set responds to these loads, so that no force jumps */
        resting_needle *r = needles[i];
        for (int u = 0; u < r->unknown_count; u++) r->free_force[u] = r->force[u] - s->force[s->row[i] + u] - s->aside[s->row[i] + u];
        for (int k = 0; k < r->motion_count; k++) r->free_motion[k] = r->motion[k] - s->move[s->motion[i] + k] - s->aside_move[s->motion[i] + k];
    }
    if (status == TROCAR_OK) take_load(s);
    else {
        trocar_error ignored;
        s->count = 0;
        inverse_attach(s->inverse, 0, NULL, &ignored);
    }
    return status;
}

/* Adds `part` times a permanent response to the forces and motions of all needles. Unlike a response to held needles, it also changes free_force and
   free_motion. */
static void add_response(resting_set *s, const double *force, const double *move, double part) {
    for (int i = 0; i < s->count; i++) {
        resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) {
            r->free_force[u] += force[s->row[i] + u] * part;
            r->force[u] += force[s->row[i] + u] * part;
        }
        for (int k = 0; k < r->motion_count; k++) {
            r->free_motion[k] += move[s->motion[i] + k] * part;
            r->motion[k] += move[s->motion[i] + k] * part;
        }
    }
}

/* ---- changes in the tissue's compliance ------------------------------------------------------------------------------------- */

/* Computes the displacements of the rows, (G + C) f + g + C m + B h. f: the needles' forces. m: the loads from the tissue's memory. h: the loads of held
   needles and the probe. G and C: compliance of the needles and of the tissue between the rows. g: what stiffening adds to G f. B: the tissue's compliance
   between h and the rows. There is no term G m, because the corresponding local displacements do not change. */
static trocar_status find_displacement(resting_set *s, const other_loads *held, double *displacement, trocar_error *why) {
    const mesh *m = inverse_tissue(s->inverse)->mesh;
    if (!make_room(s, 1 + loads_most_nodes(held))) return fail(why, TROCAR_NO_MEMORY, "no memory for the loads of held needles");
    for (int i = 0; i < s->count; i++) {
        const resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) s->force[s->row[i] + u] = r->force[u] + r->beside[u];
    }
    inverse_attached_yield(s->inverse, s->force, displacement);
    for (int i = 0; i < s->count; i++) {
        const resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) displacement[s->row[i] + u] += r->offset[u];
        for (int u = 0; u < r->unknown_count; u++)
            for (int v = 0; v < r->unknown_count; v++) displacement[s->row[i] + u] -= r->compliance[u > v ? u : v][u > v ? v : u] * r->beside[v];
    }
    int count = loads_on_nodes(m, held, s->nodes, s->nodal);
    trocar_status status = inverse_attached_under(s->inverse, &(nodal_forces){count, s->nodes, s->nodal}, displacement, why);
    if (s->cached_at != s->changes) forget_lacks(s);
    for (int i = 0; i < s->count && s->pairs && status == TROCAR_OK; i++) {
        bool any = false;
        status = find_displaced(s, i, held, s->force, &any, why);
        for (int u = 0; u < s->needles[i]->unknown_count && any; u++) displacement[s->row[i] + u] += s->force[u];
    }
    return status;
}

trocar_status resting_set_displacement(resting_set *s, const other_loads *held, double **displacement, trocar_error *why) {
    *displacement = calloc((size_t)inverse_attached_rows(s->inverse) + 1, sizeof **displacement);
    return *displacement ? find_displacement(s, held, *displacement, why) : fail(why, TROCAR_NO_MEMORY, "no memory for %d resting needles", s->count);
}

trocar_status resting_set_follow(resting_set *s, const other_loads *held, const double *before, trocar_error *why) {
    double *d;
    trocar_status status = resting_set_displacement(s, held, &d, why);
    for (int i = 0; i < inverse_attached_rows(s->inverse) && status == TROCAR_OK; i++) d[i] -= before[i];
    if (status == TROCAR_OK) inverse_attached_displaced(s->inverse, d, s->force, s->move);
    free(d);
    if (status != TROCAR_OK) return status;
    add_response(s, s->force, s->move, 1.0);
    take_load(s);
    return TROCAR_OK;
}

/* ---- slip ------------------------------------------------------------------------------------------------------------------- */

static double excess(const insertion_model *model, const resting_needle *r, int i) {
    double f = r->force[2 * r->point_count + i], upper = resting_upper(model, r, i), lower = resting_lower(model, r, i);
    return f > upper ? f - upper : f < lower ? f - lower : 0.0;
}

static bool exceeds_friction(const insertion_model *model, const resting_needle *r) {
    for (int i = 0; i < r->axial_count; i++)
        if (fabs(excess(model, r, i)) > ENOUGH) return true;
    return false;
}

/* Computes how all rows and motions respond to a unit slip of each of the needle's axial rows. Does a few rows per call and returns true once it has them all.
   */
static bool find_columns(resting_set *s, int index) {
    const resting_needle *r = s->needles[index];
    int rows[AT_ONCE], count = r->axial_count - s->columns_known[index];
    size_t n = (size_t)inverse_attached_rows(s->inverse), m = (size_t)inverse_attached_motions(s->inverse), all = (size_t)r->axial_count;
    size_t known = (size_t)s->columns_known[index];
    if (count == 0) return true;
    if (!s->columns[index]) s->columns[index] = malloc(all * (n + m) * sizeof **s->columns);
    if (!s->columns[index]) return false;
    int slice = inverse_slice(s->inverse), most = slice < AT_ONCE / 2 ? 3 * slice / 2 : AT_ONCE; /* a node takes three solves, a column two */
    if (count > most) count = most;
    for (int i = 0; i < count; i++) rows[i] = s->row[index] + 2 * r->point_count + (int)known + i;
    inverse_attached_columns(s->inverse, count, rows, s->columns[index] + known * n, s->columns[index] + all * n + known * m);
    s->columns_known[index] += count;
    return s->columns_known[index] == r->axial_count;
}

/* Finds the slips of one needle's points that bring its forces within bounds, with the slips of all other needles fixed. They minimise a convex function, so
   Gauss-Seidel iteration finds them. w: slip s at point i changes force j by w[i][j] s. w[i][i] is at most 0. */
static void find_slips(const insertion_model *model, const resting_needle *r, const double *const w[MAX_AXIAL], double slip[MAX_AXIAL]) {
    double force[MAX_AXIAL], upper[MAX_AXIAL], lower[MAX_AXIAL];
    int first = 2 * r->point_count;
    for (int i = 0; i < r->axial_count; i++) {
        force[i] = r->force[first + i];
        upper[i] = resting_upper(model, r, i);
        lower[i] = resting_lower(model, r, i);
        slip[i] = 0.0;
    }
    for (int sweep = 0; sweep < MOST_SWEEPS; sweep++) {
        double worst = 0.0;
        for (int i = 0; i < r->axial_count; i++) {
            double yields = -w[i][i], alone = force[i] + yields * slip[i]; /* alone: what the force would be without this slip */
            if (!(yields > YIELDING)) continue;
            double now = alone > upper[i] ? (alone - upper[i]) / yields : alone < lower[i] ? (alone - lower[i]) / yields : 0.0, more = now - slip[i];
            if (more == 0.0) continue;
            for (int j = 0; j < r->axial_count; j++) force[j] += w[i][j] * more;
            slip[i] = now;
            worst = fmax(worst, yields * fabs(more));
        }
        if (worst < 0.1 * ENOUGH) break;
    }
}

static bool slip_needle(resting_set *s, const insertion_model *model, int index) {
    resting_needle *r = s->needles[index];
    size_t n = (size_t)inverse_attached_rows(s->inverse), m = (size_t)inverse_attached_motions(s->inverse), count = (size_t)r->axial_count;
    const double *w[MAX_AXIAL];
    double slip[MAX_AXIAL];
    if (!find_columns(s, index)) return s->columns[index] != NULL; /* true: more columns are computed in the next call. false: out of memory, so the needle
                                                                      keeps sticking */
    const double *columns = s->columns[index];
    for (int i = 0; i < r->axial_count; i++) w[i] = columns + (size_t)i * n + (size_t)(s->row[index] + 2 * r->point_count);
    find_slips(model, r, w, slip);
    for (int i = 0; i < r->axial_count; i++) {
        if (slip[i] == 0.0) continue;
        r->slip[i] += slip[i];
        r->slid[i] += fabs(slip[i]);
        const double *force = columns + (size_t)i * n, *move = columns + count * n + (size_t)i * m;
        add_response(s, force, move, slip[i]);
    }
    return true;
}

trocar_status resting_set_load(resting_set *s, const other_loads *held, trocar_error *why) {
    if (s->count == 0) return TROCAR_OK;
    trocar_status status = respond(s, held, why);
    for (int i = 0; i < s->count && status == TROCAR_OK; i++) {
        resting_needle *r = s->needles[i];
        for (int u = 0; u < r->unknown_count; u++) r->force[u] = r->free_force[u] + s->force[s->row[i] + u] + s->aside[s->row[i] + u];
        for (int k = 0; k < r->motion_count; k++) r->motion[k] = r->free_motion[k] + s->move[s->motion[i] + k] + s->aside_move[s->motion[i] + k];
    }
    if (status == TROCAR_OK && s->any_aside) take_load(s);
    s->slips_left = status == TROCAR_OK ? MOST_ROUNDS * s->count : 0;
    s->quiet = 0;
    return status;
}

bool resting_set_slip(resting_set *s, const insertion_model *model, int most) {
    int done = 0;
    while (s->slips_left > 0 && s->quiet < s->count && done < most) {
        const resting_needle *last = s->needles[s->next_slip];
        int known = s->columns_known[s->next_slip];
        bool half_way = known > 0 && known < last->axial_count && exceeds_friction(model, last);
        if (!half_way) s->next_slip = (s->next_slip + 1) % s->count, s->slips_left--;
        if (exceeds_friction(model, s->needles[s->next_slip]) && slip_needle(s, model, s->next_slip)) done++, s->quiet = 0, s->slipped = true;
        else s->quiet++;
    }
    bool more = s->slips_left > 0 && s->quiet < s->count;
    if (s->slipped && !more) {
        take_load(s);
        s->slipped = false;
    }
    return more;
}

/* Returns the force of a row as other needles feel it: the current force plus what remains of the change in the last release. */
static double felt(const resting_needle *r, double fading, int u) { return r->force[u] + r->beside[u] + fading * r->fading[u]; }

static void list_loads(const resting_needle *r, double fading, tissue_loads *loads) {
    loads->count = 0;
    for (int i = 0; i < r->point_count; i++) {
        const attached_row *row = &r->rows[2 * i];
        if (row->tet < 0) continue;
        tissue_load *load = &loads->loads[loads->count++];
        int place = resting_place(r, 2 * i);
        *load = (tissue_load){.tet = row->tet};
        if (place >= 0) load->shaft = r->places.loads[place].shaft;
        memcpy(load->weights, row->weights, sizeof load->weights);
        for (int axis = 0; axis < 3; axis++) {
            int u = unknown(r->point_count, i, axis);
            load->force = v3_axpy(felt(r, fading, u), r->rows[u].direction, load->force);
        }
        int shaft = unknown(r->point_count, i, 2) + 1;
        if (r->tip && i + 1 == r->point_count) load->force = v3_axpy(felt(r, fading, shaft), r->rows[shaft].direction, load->force);
    }
}

void resting_loads(const resting_needle *r, tissue_loads *loads) { list_loads(r, 0.0, loads); }

trocar_status resting_set_shift(const resting_set *s, bool fades, const shaft_steps *steps, unresolved_shift *shift, trocar_error *why) {
    tissue_loads loads;
    trocar_status status = TROCAR_OK;
    for (int i = 0; i < s->count && status == TROCAR_OK; i++) {
        list_loads(s->needles[i], fades ? s->fading : 0.0, &loads);
        status = needle_pairs_shift(s->pairs, steps, &loads, shift, why);
    }
    return status;
}
