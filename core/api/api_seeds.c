/* Implements trocar/seeds.h. */
#include <string.h>

#include "api/ticking.h"
#include "api/view.h"
#include "base/flush_denormals.h"
#include "insertion/state/strata.h"

_Static_assert(TROCAR_MAX_SEEDS == (int)MAX_SEEDS && TROCAR_MAX_STRAND == (int)MAX_STRAND, "limits differ from trocar.h");

/* RT */
static trocar_status refuse_drop(const trocar_sim *sim, int needle, int count, double spacing, seed_refusal refusal, trocar_error *why) {
    const seed_size *size = &sim->model->parts.config.seeds;
    const insertion_state *state = &sim->needles[needle].state;
    const double mm = 1e3;
    switch (refusal) {
    case SEEDS_ACCEPTED: return TROCAR_OK;
    case SEEDS_BAD_COUNT: return fail(why, TROCAR_BAD_INPUT, "%d seeds: drop 1 to %d at a time", count, (int)MAX_STRAND);
    case SEEDS_BAD_SPACING:
        return fail(why, TROCAR_BAD_INPUT, "seeds of %g mm overlap at a spacing of %g mm: give their distance from centre to centre, or 0 for the scene's",
                    mm * size->length, mm * spacing);
    case SEEDS_TOO_THICK:
        return fail(why, TROCAR_BAD_INPUT, "seeds of %g mm do not fit in a needle of %g mm: change the scene's seeds.diameter or needle", mm * size->diameter,
                    2.0 * mm * sim->model->parts.needle.radius);
    case SEEDS_PENDING:
        return fail(why, TROCAR_BAD_INPUT, "needle %d still holds %d of the seeds dropped before: draw it back, or undo", needle, seeds_pending(needle, &sim->seeds));
    case SEEDS_FULL: return fail(why, TROCAR_BAD_INPUT, "no room for %d more: a simulation has at most %d seeds", count, (int)MAX_SEEDS);
    case SEEDS_TOO_LONG:
        return fail(why, TROCAR_BAD_INPUT, "needle %d is %.1f mm deep in the tissue, less than the %.1f mm of the seeds: push it farther in", needle,
                    mm * (state->tip.place.depth - tip_entry_depth(state)), mm * seeds_strand_length(size, count, spacing));
    case SEEDS_OUTSIDE:
    default: return fail(why, TROCAR_BAD_INPUT, "the tip of needle %d is outside the tissue: seeds can be dropped only in the tissue", needle);
    }
}

trocar_status trocar_sim_drop_seeds(trocar_sim *sim, int needle, int count, double spacing, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (check_needle(sim, needle, why) != TROCAR_OK) return TROCAR_BAD_INPUT;
    adopt_needle(sim, &sim->needles[needle]);
    if (link_refuses(&sim->needles[needle].link, ON_TICK)) return fail(why, TROCAR_BAD_INPUT, "needle %d rests: take it first", needle);
    floating_mode before = flush_denormals();
    seed_refusal refusal = seeds_drop(ticking_model(sim), &sim->model->parts.config.seeds, &sim->needles[needle].state, needle, count, spacing,
                                      &sim->seeds);
    restore_floating_mode(before);
    return refuse_drop(sim, needle, count, spacing, refusal, why);
}

trocar_status trocar_sim_undo_seed(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (check_needle(sim, needle, why) != TROCAR_OK) return TROCAR_BAD_INPUT;
    if (seeds_undo(needle, &sim->seeds) == SEEDS_ACCEPTED) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "needle %d has no dropped seed to take back", needle);
}

trocar_status trocar_sim_clear_seeds(trocar_sim *sim, int needle, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (check_needle(sim, needle, why) != TROCAR_OK) return TROCAR_BAD_INPUT;
    seeds_clear(needle, &sim->seeds);
    return TROCAR_OK;
}

trocar_seed_size trocar_model_seed_size(const trocar_model *model) {
    const seed_size *size = &model->parts.config.seeds;
    return (trocar_seed_size){size->length, size->diameter, size->spacing};
}

int trocar_model_displace_seed(const trocar_model *model, const double *displacements, const trocar_seed *given, double position[3], double direction[3]) {
    if (given->tet < 0 || given->tet >= model->parts.mesh.tet_count) return 0;
    seed s = {.tet = given->tet, .at = v3(given->position[0], given->position[1], given->position[2]),
              .direction = v3(given->direction[0], given->direction[1], given->direction[2])};
    memcpy(s.weights, given->weights, sizeof s.weights);
    vec3 at, along;
    seed_displaced(&model->parts.mesh, &s, (const vec3 *)(const void *)displacements, &at, &along);
    store_vec3(at, position);
    store_vec3(along, direction);
    return 1;
}
