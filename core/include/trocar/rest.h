/* Needles left to rest in the tissue, with nobody holding them. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_REST_H
#define TROCAR_PUBLIC_REST_H

#include "trocar/sim.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Lets go of a needle in the tissue. The needle is LEAVING until the worker (in lockstep, the next step) has found its equilibrium, and then RESTING. If it
   has no equilibrium, the worker's call (in lockstep, that step) fails and the needle stays HELD. BAD_INPUT if `needle` is out of range, or if the needle is
   outside the tissue, still moving to another equilibrium, or not held. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_leave(trocar_sim *sim, int needle, trocar_error *error);

/* Takes hold of a resting needle. The needle is TAKING until the worker (in lockstep, the next step) has handed it over, and then HELD. Pass the pose from
   trocar_view_base to its first tick. BAD_INPUT if `needle` is out of range or the needle is not resting. [tick, RT, wakes] */
TROCAR_API trocar_status trocar_sim_take(trocar_sim *sim, int needle, trocar_error *error);

typedef enum trocar_needle_state {
    TROCAR_NEEDLE_HELD,      /* driven by the caller, even while it is outside the tissue */
    TROCAR_NEEDLE_LEAVING,
    TROCAR_NEEDLE_RESTING,
    TROCAR_NEEDLE_TAKING
} trocar_needle_state;

/* Returns the needle's state; HELD if it is out of range. [tick, RT] */
TROCAR_API trocar_needle_state trocar_sim_needle_state(const trocar_sim *sim, int needle);

#ifdef __cplusplus
}
#endif
#endif
