/* Changing parameters during a run: friction, cutting and puncture forces, moduli, calcifications and guides. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_CHANGE_H
#define TROCAR_PUBLIC_CHANGE_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* New values for every parameter that can change during a run. Any thread can prepare a change; a simulation then adopts it between two ticks. */
typedef struct trocar_change trocar_change;

/* Creates a change holding the simulation's current values (or, if a change is under way, the values it leads to); modify it with trocar_change_set.
   NO_MEMORY. [alone, allocates] */
TROCAR_API trocar_status trocar_change_create(const trocar_sim *sim, trocar_change **change, trocar_error *error);

/* Creates an independent copy. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_change_copy(const trocar_change *change, trocar_change **copy, trocar_error *error);
TROCAR_API void trocar_change_free(trocar_change *change);

/* Sets keys as in trocar_scene_set, given one per line, for example "membranes[skin].puncture_force: 2\nregions[gland].cutting_force: 1". BAD_INPUT,
   changing nothing, for a key that cannot change during a run (the message names it), an entry that does not exist, a bad value, kinetic friction above
   static friction, and a cutting or puncture force that is, or would become, .inf (bone). NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_change_set(trocar_change *change, const char *lines, trocar_error *error);

/* Builds a model with the new moduli if any of them (Young's modulus, stiffening, membrane stiffness) differs from the simulation's; otherwise does nothing.
   This takes as long as creating a model: from a second for a small mesh to hours for a large one. `watch` may be NULL. NO_MEMORY, CANCELLED, NUMERIC, and,
   for a large mesh, SYSTEM. [one, allocates] */
TROCAR_API trocar_status trocar_change_prepare(trocar_change *change, const trocar_watch *watch, trocar_error *error);

/* Returns 1 if the change is ready for trocar_sim_change: no modulus has changed, or a model with the new moduli has been built. Otherwise 0. [one] */
TROCAR_API int trocar_change_prepared(const trocar_change *change);

/* Enumerate the keys that can change. trocar_change_count returns their number. trocar_change_at writes the key with this index, for example
   "regions[gland].friction.static", and its value, and returns 1; if `index` is out of range, it writes nothing and returns 0. [one] */
enum { TROCAR_CHANGE_KEY = 128 };
TROCAR_API int trocar_change_count(const trocar_change *change);
TROCAR_API int trocar_change_at(const trocar_change *change, int index, char key[TROCAR_CHANGE_KEY], double *value);

/* How long a change may take, in s of simulated time. */
#define TROCAR_CHANGE_TIME 0.5       /* default of trocar's programs */
#define TROCAR_CHANGE_TIME_LEAST 0.1
#define TROCAR_CHANGE_TIME_MOST 60.0

/* Starts a change, replacing any that is still under way. Over the next `time` seconds of simulated time, every value moves linearly from its current to its
   new value, by at most 2 % of the difference per tick. Contact forces start from where they are and follow the moving limits, so the wrench does not jump.
   A membrane is punctured as soon as its puncture force falls below the force of the tip on it. A resting needle keeps the friction it was left with until it
   is taken. If moduli differ, the tissue's compliance moves to that of the prepared model, by at most 2 % per tick; this may take longer than `time`,
   especially while needles rest. The simulation keeps no reference to `change`. BAD_INPUT, changing nothing, if `time` is out of range, if the change was
   made for another model or, with different moduli, if the change is not prepared or not accepted (trocar_sim_accepts); NO_MEMORY only for a simulation in
   a batch. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_change(trocar_sim *sim, const trocar_change *change, double time, trocar_error *error);

/* Returns 0 if the simulation's moduli are still moving and `change` would send them somewhere else; otherwise 1. [tick, RT] */
TROCAR_API int trocar_sim_accepts(const trocar_sim *sim, const trocar_change *change);

/* Returns how much simulated time (s) is left until the last change is complete; 0 if it already is. [tick, RT] */
TROCAR_API double trocar_sim_changing(const trocar_sim *sim);

#ifdef __cplusplus
}
#endif
#endif
