/* The worker lays needles down, keeps them at rest, and returns them. See docs/mechanics.md, "Resting needles". */
#ifndef TROCAR_WORKER_RESTING_H
#define TROCAR_WORKER_RESTING_H

#include "api/api.h"

typedef struct {
    bool any;                /* request was carried out, or failed */
    bool kept;               /* a needle that was to be left does not come to rest in the tissue: it is held as before */
} resting_change;

/* Carries out pending requests to leave, take or remove needles. On an error the needle stays where it was. */
trocar_status change_resting(trocar_sim *sim, resting_change *change, report *why);

/* Forces of held needles have changed. Not `all`: slip_some does the rest. */
trocar_status respond_to_loads(trocar_sim *sim, bool all, report *why);

/* Lets what rests slip, all or one needle, and shows what has changed. True: there is more to do. */
bool slip_some(trocar_sim *sim, bool all);

/* After a restore: room for a needle that rests; attaches what rests, and shows it. */
trocar_status make_room_to_rest(trocar_sim *sim, needle_track *needle, report *why);
trocar_status rest_again(trocar_sim *sim, report *why);

#endif
