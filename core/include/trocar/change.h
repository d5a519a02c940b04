/* Changing parameters during a run: friction, cutting and puncture forces, moduli, calcifications and guides. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_CHANGE_H
#define TROCAR_PUBLIC_CHANGE_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* New values for all parameters that may change during a run. A change is prepared in any thread, and a simulation then takes it over between two ticks. */
typedef struct trocar_change trocar_change;

/* Creates a change that contains the simulation's current values (or final values, if a change is under way), to be modified by trocar_change_set.
   NO_MEMORY. [alone, allocates] */
TROCAR_API trocar_status trocar_change_create(const trocar_sim *sim, trocar_change **change, trocar_error *error);

/* Creates an independent copy. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_change_copy(const trocar_change *change, trocar_change **copy, trocar_error *error);
TROCAR_API void trocar_change_free(trocar_change *change);

/* Sets keys to values, in lines of "key: value", as in trocar_scene_set, for example "membranes[skin].puncture_force: 2\nregions[gland].cutting_force: 1".
   BAD_INPUT, without effect, for a key that cannot change during a run (the message names it), an entry that does not exist, a bad value, kinetic friction
   above static friction, and a cutting or puncture force that is or would become .inf (bone). NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_change_set(trocar_change *change, const char *lines, trocar_error *error);

/* If the moduli differ from those of the simulation (Young's moduli, stiffening, the stiffness of membranes), builds a model with them. This takes as long as
   creating a model: from a second for a small mesh to hours for a large one. Does nothing if no modulus has changed. `watch` may be NULL. NO_MEMORY, CANCELLED,
   NUMERIC, and, for a large mesh, SYSTEM. [one, allocates] */
TROCAR_API trocar_status trocar_change_prepare(trocar_change *change, const trocar_watch *watch, trocar_error *error);

/* Returns 1 if a simulation can take the change over, because it has a model with its moduli; otherwise 0. [one] */
TROCAR_API int trocar_change_prepared(const trocar_change *change);

/* trocar_change_count returns the number of keys that may change. trocar_change_at writes one of them, such as "regions[gland].friction.static", and its
   value, and returns 1; if `index` is out of range, it writes nothing and returns 0. [one] */
enum { TROCAR_CHANGE_KEY = 128 };
TROCAR_API int trocar_change_count(const trocar_change *change);
TROCAR_API int trocar_change_at(const trocar_change *change, int index, char key[TROCAR_CHANGE_KEY], double *value);

/* Duration of a change, in s of simulated time. */
#define TROCAR_CHANGE_TIME 0.5       /* default of trocar's programs */
#define TROCAR_CHANGE_TIME_LEAST 0.1
#define TROCAR_CHANGE_TIME_MOST 60.0

/* Takes over a change: during the next `time` seconds of simulated time, every value moves linearly from its current to its new value, by at most 2 % of the
   change per tick, for all held needles. A resting needle keeps the friction with which it was left until it is taken. Contact forces do not change at first
   and then follow the moving limits, so the wrench does not jump. A membrane is punctured as soon as its limit falls below the force with which the tip presses
   on it. Replaces any change that is still under way. The simulation does not refer to `change` afterwards. If moduli differ, the tissue's compliance moves to
   that of the prepared model, by at most 2 % per tick; this may take longer than `time`, especially while needles rest. BAD_INPUT, without effect, for a time
   out of range, for a change made for another model and, if moduli differ, for a change that is not prepared or not accepted (trocar_sim_accepts); NO_MEMORY
   only for a simulation of a batch. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_change(trocar_sim *sim, const trocar_change *change, double time, trocar_error *error);

/* Returns 0 if the simulation's moduli are still moving and `change` would move them to other values; otherwise 1. [tick, RT] */
TROCAR_API int trocar_sim_accepts(const trocar_sim *sim, const trocar_change *change);

/* Returns the simulated time (s) until the last change is complete; 0 if it already is. [tick, RT] */
TROCAR_API double trocar_sim_changing(const trocar_sim *sim);

#ifdef __cplusplus
}
#endif
#endif
