/* The worker's part of a lockstep step. In lockstep, the ticking thread does it itself; otherwise, a worker thread calls trocar_sim_work (trocar.h). */
#ifndef TROCAR_WORKER_H
#define TROCAR_WORKER_H

#include "api/api.h"

/* To call before a tick: applies the effects of other needles and the probe on the tissue. Sets *outdated if the needle's last answer is no longer valid. */
trocar_status worker_before_tick(trocar_sim *sim, int needle, bool *outdated, trocar_error *why);

/* To call after a tick that used `answer`: lets resting needles and the probe respond, and answers the needle's current request. */
trocar_status worker_after_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, double dt, trocar_error *why);

#endif
