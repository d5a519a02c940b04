/* The worker's answers to requests. */
#ifndef TROCAR_WORKER_ANSWER_H
#define TROCAR_WORKER_ANSWER_H

#include "api/api.h"

/* Numbers of changes: of the attachments, and of the forces that they exert without held needles. */
static inline uint64_t attached_changes(const trocar_sim *sim) { return sim->resting.changes + (sim->probe ? sim->probe->changes : 0); }
static inline uint64_t attached_shifts(const trocar_sim *sim) { return sim->resting.shifts + (sim->probe ? sim->probe->shifts : 0); }

/* Lists the loads on the tissue from all bodies except one needle, the resting needles, or the probe. */
enum { BESIDE_RESTING = -1, BESIDE_PROBE = -2 };
void list_others(const trocar_sim *sim, int needle, other_loads *others);

/* Marks the answers of other needles as stale, so that they request again. */
void mark_stale(trocar_sim *sim, const needle_track *except);

/* Writes the complete answer to a request to the slot for this needle's answers. */
trocar_status answer_fully(trocar_sim *sim, int needle, const remesh_request *request, report *why);

/* Answers this needle's present request completely and publishes it; in lockstep, where both threads are the same. */
trocar_status answer_and_publish(trocar_sim *sim, int needle, report *why);

/* Answers the newest request of this needle, if there is one: first the rows, then the mesh's resolution line by line, until there is a newer request. The
   first line, which is the tip's, is always measured: otherwise a slow worker, which always has a newer request, would never measure any. */
trocar_status answer_request(trocar_sim *sim, int needle, trocar_work *work, report *why);

/* Prefetches in idle time. Returns false if nothing is left to do. */
bool look_ahead(trocar_sim *sim);

#endif
