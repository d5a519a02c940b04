/* The worker's handling of resting needles: attaches them to the tissue, keeps them in equilibrium, and returns them. See docs/mechanics.md, "Resting
   needles". */
#ifndef TROCAR_WORKER_RESTING_H
#define TROCAR_WORKER_RESTING_H

#include "api/api.h"

typedef struct {
    bool any;                /* true if there was a request, which has been carried out or has failed */
    bool kept;               /* true if a needle could not come to rest in the tissue and therefore stays held */
} resting_change;

/* Carries out pending requests to leave, take or remove needles. After an error, the needle stays where it was. */
trocar_status change_resting(trocar_sim *sim, resting_change *change, trocar_error *why);

/* Lets resting needles respond to changes in the forces of held needles. Unless `all` is true, slips are left to slip_some(). */
trocar_status respond_to_loads(trocar_sim *sim, bool all, trocar_error *why);

/* Lets all resting needles (or, unless `all` is true, one of them) slip, and shows the changes. Returns true if more needles have to slip. */
bool slip_some(trocar_sim *sim, bool all);

/* To be called before and after a step in the moduli. The first returns the displacements of the resting needles' contact points, to be freed by the caller;
   the second uses them to let the needles follow. */
trocar_status rest_before_softening(trocar_sim *sim, double **displacement, trocar_error *why);
trocar_status rest_after_softening(trocar_sim *sim, const double *displacement, trocar_error *why);

/* make_room_to_rest allocates memory for a resting needle. rest_again, to be called after a restore, attaches the resting needles and shows them. */
trocar_status make_room_to_rest(trocar_sim *sim, sim_needle *needle, trocar_error *why);
trocar_status rest_again(trocar_sim *sim, trocar_error *why);

#endif
