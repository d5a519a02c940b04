/* The worker's answers to requests. */
#ifndef TROCAR_WORKER_ANSWER_H
#define TROCAR_WORKER_ANSWER_H

#include "api/api.h"

/* Counters for detecting outdated answers. attached_changes counts changes to what is attached to the inverse (resting needles, probe); attached_shifts counts
   changes to the forces that these would exert if no needle were held. */
static inline uint64_t attached_changes(const trocar_sim *sim) { return sim->resting.changes + (sim->probe ? sim->probe->changes : 0); }
static inline uint64_t attached_shifts(const trocar_sim *sim) { return sim->resting.shifts + (sim->probe ? sim->probe->shifts : 0); }

/* Lists the loads that all bodies except one exert on the tissue. `needle` is the body to leave out: the index of a needle, BESIDE_RESTING or BESIDE_PROBE. */
enum { BESIDE_RESTING = -1, BESIDE_PROBE = -2 };
void list_others(const trocar_sim *sim, int needle, other_loads *others);

/* Marks the answers of all needles but one (`except`, may be NULL) as stale, so that those needles post new requests. */
void mark_stale(trocar_sim *sim, const sim_needle *except);

/* Writes the complete answer to a request to this needle's answer slot. */
trocar_status answer_fully(trocar_sim *sim, int needle, const remesh_request *request, trocar_error *why);

/* Writes the complete answer to this needle's current request and publishes it. For lockstep, where requests are not posted. */
trocar_status answer_and_publish(trocar_sim *sim, int needle, trocar_error *why);

/* Answers this needle's newest request, if there is one. First computes the rows, then measures the mesh's resolution line by line until a newer request
   arrives. The first line, the tip's, is always measured; otherwise, a slow worker that always has a newer request pending would never measure any. */
trocar_status answer_request(trocar_sim *sim, int needle, trocar_work *work, trocar_error *why);

/* Prefetches contact nodes; call it when there is no other work. Returns false if nothing is left to prefetch. */
bool look_ahead(trocar_sim *sim);

#endif
