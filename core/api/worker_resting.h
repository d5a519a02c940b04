/* The worker's handling of resting needles: attaches them to the tissue, keeps them in equilibrium, and returns them. See docs/mechanics.md, "Resting
   needles". */
#ifndef TROCAR_WORKER_RESTING_H
#define TROCAR_WORKER_RESTING_H

#include "api/api.h"

typedef struct {
    bool any;                /* true if there was a request, whether it succeeded or failed */
    bool kept;               /* true if a needle could not come to rest in the tissue, so it stays held */
} resting_change;

/* Carries out pending requests to leave, take or remove needles. */
trocar_status change_resting(trocar_sim *sim, resting_change *change, trocar_error *why);

/* Lets resting needles respond to changes in the held needles' forces. If `all` is true, also lets them slip; otherwise, that is left to slip_some(). */
trocar_status respond_to_loads(trocar_sim *sim, bool all, trocar_error *why);

/* Lets resting needles slip: all if `all` is true, otherwise one. Once none has to slip any more, publishes the changed needles. Returns true if more have to
   slip. */
bool slip_some(trocar_sim *sim, bool all);

/* Call these before and after a step in the moduli. The first returns the displacements of the resting needles' contact points, which the caller must free; the
   second uses them to make the needles follow the tissue. */
trocar_status rest_before_softening(trocar_sim *sim, double **displacement, trocar_error *why);
trocar_status rest_after_softening(trocar_sim *sim, const double *displacement, trocar_error *why);

/* make_room_to_rest allocates memory for a resting needle. rest_again attaches the resting needles and publishes them, after a restore. */
trocar_status make_room_to_rest(trocar_sim *sim, sim_needle *needle, trocar_error *why);
trocar_status rest_again(trocar_sim *sim, trocar_error *why);

#endif
