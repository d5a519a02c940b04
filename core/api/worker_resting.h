/* The worker's part of resting needles: attaches needles, keeps them at rest, and returns them. See docs/mechanics.md, "Resting needles". */
#ifndef TROCAR_WORKER_RESTING_H
#define TROCAR_WORKER_RESTING_H

#include "api/api.h"

typedef struct {
    bool any;                /* a request was carried out, or failed */
    bool kept;               /* a needle could not come to rest in the tissue, and stays held */
} resting_change;

/* Carries out pending requests to leave, take back or remove needles. On an error the needle stays where it was. */
trocar_status change_resting(trocar_sim *sim, resting_change *change, report *why);

/* Responds to changed forces of held needles. If not `all`, slips are left to slip_some. */
trocar_status respond_to_loads(trocar_sim *sim, bool all, report *why);

/* Lets all resting needles slip, or one of them, and shows the changes. Returns true if there is more to do. */
bool slip_some(trocar_sim *sim, bool all);

/* After a restore: allocates memory for a resting needle; attaches the resting needles and shows them. */
trocar_status make_room_to_rest(trocar_sim *sim, needle_track *needle, report *why);
trocar_status rest_again(trocar_sim *sim, report *why);

#endif
