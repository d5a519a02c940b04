/* The worker's answers to requests. */
#ifndef TROCAR_WORKER_ANSWER_H
#define TROCAR_WORKER_ANSWER_H

#include "api/api.h"

/* Of all that is attached to the tissue, and of the forces that it exerts if no needle is held. */
static inline uint64_t attached_changes(const trocar_sim *sim) { return sim->resting.changes + (sim->probe ? sim->probe->changes : 0); }
static inline uint64_t attached_shifts(const trocar_sim *sim) { return sim->resting.shifts + (sim->probe ? sim->probe->shifts : 0); }

/* What deforms the tissue beside one needle, or beside all that rest, or beside the probe. */
enum { BESIDE_RESTING = -1, BESIDE_PROBE = -2 };
void list_others(const trocar_sim *sim, int needle, other_loads *others);

/* Other needles are to ask again. */
void mark_stale(trocar_sim *sim, const needle_track *except);

/* Puts the whole answer to a request into the slot for this needle's answers. */
trocar_status answer_fully(trocar_sim *sim, int needle, const remesh_request *request, report *why);

/* The whole answer to what this needle, of the same thread, asks for now. */
trocar_status answer_and_publish(trocar_sim *sim, int needle, report *why);

/* Answers the newest request of this needle, if there is one: first the rows, then line after line what the mesh resolves, until there is a
   newer one. The first line, which is the tip's, is always measured: a worker so slow that there is always a newer one would never measure any. */
trocar_status answer_request(trocar_sim *sim, int needle, trocar_work *work, report *why);

/* For idle time. False: nothing is left to do. */
bool look_ahead(trocar_sim *sim);

#endif
