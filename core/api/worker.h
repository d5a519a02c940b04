/* The worker in lockstep: the thread that ticks does its work as well. trocar_sim_work, in trocar.h, is its work in a thread of its own. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "api/api.h"

/* Before a tick: what others and what rests do to the tissue is known at once. *outdated: the needle's last answer no longer holds. */
trocar_status worker_before_tick(trocar_sim *sim, int needle, bool *outdated, report *why);

/* After it, which went by `answer`: what rests and the probe respond, and the needle gets the answer to what it asks for now. */
trocar_status worker_after_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, double dt, report *why);

#endif
