/* The worker's side of the probe. See docs/mechanics.md, "Probe". */
#ifndef TROCAR_WORKER_PROBE_H
#define TROCAR_WORKER_PROBE_H

#include "api/api.h"
#include "saved/state_stream.h"

trocar_status create_probe(trocar_sim *sim, trocar_error *why);

/* Reads the probe's newest pose. Returns true if it is new. */
bool take_probe_pose(trocar_sim *sim);

/* Presses the probe against the tissue at its newest pose. Call it after the probe has moved or other loads have changed. */
trocar_status press_probe(trocar_sim *sim, trocar_error *why);

/* Save and restore the probe. Call them between lockstep steps. */
void save_probe(state_stream *to, trocar_sim *sim);
trocar_status restore_probe(state_stream *from, trocar_sim *sim, trocar_error *why);

#endif
