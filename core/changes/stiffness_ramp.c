#include "changes/stiffness_ramp.h"

#include <math.h>

#include "base/vec.h"

static const double MEMBRANE = 1.0; /* logarithm of a factor: a change in membrane stiffness is assumed to change the compliance by up to this, in either
                                       direction; its true effect is not known in advance. Chosen by judgement: a factor of 2.7 */
static const double MOST = 0.02;    /* fraction: largest change in compliance per tick. Chosen: less than a third of the 7 % that people notice */

/* Each element's strain energy changes by a factor between the smallest and the largest factor by which a modulus changes. The compliance as a whole, in any
   direction, therefore does too. */
stiffness_ramp ramp_between(const simulation_config *from, const simulation_config *to) {
    double softest = 1.0, stiffest = 1.0;
    bool membranes = false;
    for (int i = 0; i < from->region_count; i++) {
        double factor = from->regions[i].material.youngs_modulus / to->regions[i].material.youngs_modulus;
        softest = fmax(softest, factor);
        stiffest = fmin(stiffest, factor);
    }
    for (int i = 0; i < from->membrane_count; i++) membranes |= from->membranes[i].material.stiffness != to->membranes[i].material.stiffness;
    if (membranes) softest *= exp(MEMBRANE), stiffest *= exp(-MEMBRANE);
    stiffness_ramp r = {.softer = softest - 1.0, .stiffer = 1.0 - stiffest};
    double twice = 2.0 * r.softer * r.stiffer;
    r.crossing = twice > 0.0 ? fmin(fmax((r.softer - r.stiffer) / twice, 0.0), 1.0) : r.softer > 0.0;
    r.first = log1p(r.softer * r.crossing);
    r.whole = r.first + log((1.0 - r.stiffer * r.crossing) / stiffest);
    if (r.crossing == 1.0) r.whole = r.first;
    return r;
}

double ramp_weight(const stiffness_ramp *r, double part) {
    if (part == 0.0 || part == 1.0 || r->whole == 0.0) return part;
    double way = part * r->whole;
    if (way < r->first) return expm1(way) / r->softer;
    return (1.0 - (1.0 - r->stiffer * r->crossing) * exp(r->first - way)) / r->stiffer;
}

double ramp_step(const stiffness_ramp *r) { return r->whole > 1.0 ? MOST / r->whole : MOST; }
