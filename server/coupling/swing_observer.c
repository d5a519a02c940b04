#include "coupling/swing_observer.h"

#include <stdbool.h>

static const double SHORTEST = 0.2e-3;      /* m, shorter swings are ignored; physiological tremor has a smaller amplitude */
static const double SLOWEST = 0.15;         /* s, longest time between turning points; corresponds to 3.3 Hz */
/* A swing counts as undamped if it is longer than this fraction of the previous one in the same direction, that is, if damping is below 1.7 % of critical. */
static const double LASTING = 0.9;
static const double LEAST_CHANGE = 0.01;    /* N: if the force changes by less during a swing, the coupling is not what drives the swing */

void swing_begin(swing_observer *s, vec3 position, int64_t now) {
    *s = (swing_observer){.turn = position, .farthest = position, .turned = now, .reached = now};
}

/* Ends the current swing. The farthest point it reached is the new turning point. */
static int end_swing(swing_observer *s, vec3 force) {
    double length = v3_norm(v3_sub(s->farthest, s->turn)), time = 1e-9 * (double)(s->reached - s->turned);
    bool lasts = length > fmax(SHORTEST, LASTING * s->lengths[0]) && time < SLOWEST && s->stir > LEAST_CHANGE;
    s->lasting = lasts ? s->lasting + 1 : 0;
    s->lengths[0] = s->lengths[1];
    s->lengths[1] = length;
    s->turn = s->farthest;
    s->turned = s->reached;
    s->force = force;
    s->stir = 0.0;
    return s->lasting;
}

int swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now) {
    int lasting = 0;
    bool farther = v3_norm(v3_sub(position, s->turn)) >= v3_norm(v3_sub(s->farthest, s->turn));
    bool turned = !farther && v3_norm(v3_sub(position, s->farthest)) > 0.5 * SHORTEST;
    s->stir = fmax(s->stir, v3_norm(v3_sub(force, s->force)));
    if (turned) lasting = end_swing(s, force);
    if (!turned && !farther) return 0;
    s->farthest = position;
    s->reached = now;
    return lasting;
}
