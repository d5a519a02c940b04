/* The worker in lockstep: the ticking thread also does the worker's work. trocar_sim_work, in trocar.h, is the work of a separate thread. */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "api/api.h"

/* Before a tick: applies the effects of other needles and the probe on the tissue. *outdated: the needle's last answer is no longer valid. */
trocar_status worker_before_tick(trocar_sim *sim, int needle, bool *outdated, report *why);

/* After a tick that used `answer`: lets resting needles and the probe respond, and answers the needle's present request. */
trocar_status worker_after_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, double dt, report *why);

#endif
