#include "insertion/model/stiffening_law.h"

#include <math.h>
#include <stdbool.h>

/* Solves y (1 + y^2) = b for the shear y (in units of 1 / sqrt(2 S)) at the stress b (in units of mu / sqrt(2 S)). Newton's method converges monotonically from
   above and is exact to the last bit after six steps for any b. */
static double shear_of(double b) {
    double y = b < 1.0 ? b : cbrt(b);
    for (int i = 0; i < 6; i++) y -= (y * (1.0 + y * y) - b) / (1.0 + 3.0 * y * y);
    return y;
}

enum { MOST_FORCES = 30 }; /* iterations: most when searching for the force at a given displacement. Cost limit: 8 are enough for S = 10 */
static const double SAME_FORCE = 1e-6; /* dimensionless: the iteration ends when the force changes by less than this fraction. Rounding: the force is only used
                                          as a linearisation point */
static const double RIGID = 1e-3; /* fraction of the linear compliance: the iteration ends if the compliance falls below this. Rounding: the force is only used
                                     as a linearisation point */

/* ---- shaft: shear stress F' / (2 pi rho) at the distance rho ----------------------------------------------------------------

   The change in the linear displacement is the integral of g - F' / (2 pi mu rho) from the radius r to infinity. Substituting g for rho gives
   a (q / (1 + q) - 3/2 ln(1 + q)), where a = F' / (2 pi mu) and q = 2 S g^2 at r. Nearly all of it arises within a few radii of the shaft, so it does not
   depend on the radius that the mesh resolves. */

static stiffening_shift shaft_field(double b) {
    double y = shear_of(b), q = y * y;
    return (stiffening_shift){b * (q / (1.0 + q) - 1.5 * log1p(q)), -1.5 * log1p(q)};
}

static const double KEPT_LOGARITHM = 0.1; /* dimensionless: stiffening reduces the logarithm in the local compliance to no less than this. Contacts in the same
                                             element have dependent displacements in the mesh; this keeps them independent. Chosen by judgement */

/* Returns the stress b at which the slope is -most. */
static double shaft_limit(double most) {
    double q = expm1(most / 1.5);
    return sqrt(q) * (1.0 + q);
}

/* ---- tip: stress 0.8 F sqrt(D mu / angle) / rho^2 at the distance rho --------------------------------------------------------

   The field is the same in all directions, and begins at the distance r. Without the factor 0.8, it would have the energy of the linear disc, whose
   compliance is D / r. The displacement is the integral of the shear from r to infinity; divided by the linear displacement at b = 1, it is sqrt(b) I(y) - y,
   where I(y) is the integral of 1 / sqrt(t (1 + t^2)) from 0 to y. For small forces, this is b - b^3 / 5; for large ones, it grows with sqrt(b), so the force
   grows with the square of the dent. */

static const double STRESS = 0.8; /* dimensionless: stress on the disc, relative to the uniform stress with the energy of the linear disc. Fitted to a resolved
                                     disc, S = 1, pressed in by 2.5 radii (tests/unit/insertion/test_stiffening.c) */
static const double WHOLE = 3.7081493546027438; /* dimensionless: I(infinity). Exact: Gamma(1/4)^2 / (2 sqrt(pi)) */
static const double SMALL = 1e-3; /* dimensionless: below this force, only the first term of the tip law's series is used. Derived: the next term is 1e-6 times
                                     the first */

/* Returns twice the integral of 1 / sqrt(1 + s^4) from 0 to sqrt(y), for y <= 1, by Gauss quadrature with eight points. */
static double small_integral(double y) {
    static const double at[4] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267, 0.9602898564975363};
    static const double weight[4] = {0.3626837833783620, 0.3137066458778873, 0.2223810344533745, 0.1012285362903763};
    double half = 0.5 * sqrt(y), sum = 0.0;
    for (int i = 0; i < 4; i++) {
        double low = half * (1.0 - at[i]), high = half * (1.0 + at[i]);
        sum += weight[i] * (1.0 / sqrt(1.0 + low * low * low * low) + 1.0 / sqrt(1.0 + high * high * high * high));
    }
    return 2.0 * half * sum;
}

static double integral(double y) { return y <= 1.0 ? small_integral(y) : WHOLE - small_integral(1.0 / y); }

static double tip_slope(double y) { return 0.5 * integral(y) / sqrt(y * (1.0 + y * y)) - 1.0; }

static stiffening_shift tip_field(double b) {
    if (b < SMALL) return (stiffening_shift){-0.2 * b * b * b, -0.6 * b * b};
    double y = shear_of(b);
    return (stiffening_shift){sqrt(b) * integral(y) - y - b, tip_slope(y)};
}

/* Finds the limit by bisection, to a relative width of 2^-40: the slope decreases monotonically with y to -1. */
static double tip_limit(double most) {
    double low = 0.0, high = 1.0;
    while (tip_slope(high) > -most && high < 1e6) high *= 2.0;
    for (int i = 0; i < 40; i++) {
        double middle = 0.5 * (low + high);
        *(tip_slope(middle) > -most ? &low : &high) = middle;
    }
    return low * (1.0 + low * low);
}

/* ---- both ----------------------------------------------------------------------------------------------------------------- */

stiffening_law stiffening_of_shaft(double stiffening, double radius, double stiffness, double room) {
    if (stiffening == 0.0) return (stiffening_law){.field = NOT_STIFFENING};
    double shear = sqrt(2.0 * stiffening);
    return (stiffening_law){STIFFENING_SHAFT, radius / shear, shear / (radius * stiffness), fmax(room * stiffness - KEPT_LOGARITHM, 0.0), room};
}

stiffening_law stiffening_of_tip(double stiffening, double radius, double disc, double softness, double angle, double room) {
    if (stiffening == 0.0 || softness == 0.0) return (stiffening_law){.field = NOT_STIFFENING};
    double scale = STRESS * sqrt(2.0 * stiffening * disc * radius * softness / angle) / (radius * radius);
    return (stiffening_law){STIFFENING_TIP, disc / scale, scale, fmax(room, 0.0) / disc, room};
}

/* The law is odd in the force, and continues with constant slope beyond the limit. */
stiffening_shift stiffening_at(const stiffening_law *law, double force) {
    if (law->field == NOT_STIFFENING) return (stiffening_shift){0.0, 0.0};
    bool shaft = law->field == STIFFENING_SHAFT;
    double b = law->scale * fabs(force);
    stiffening_shift at = shaft ? shaft_field(b) : tip_field(b);
    if (-at.slope > law->most) {
        double limit = shaft ? shaft_limit(law->most) : tip_limit(law->most);
        at = shaft ? shaft_field(limit) : tip_field(limit);
        at = (stiffening_shift){at.shift - law->most * (b - limit), -law->most};
    }
    return (stiffening_shift){copysign(law->unit, force) * at.shift, law->unit * law->scale * at.slope};
}

/* Uses Newton's method. The displacement is a concave function of the force, so the iteration converges from below. */
double stiffening_force(const stiffening_law *law, double displacement) {
    double sought = fabs(displacement), force = law->linear > 0.0 ? sought / law->linear : 0.0;
    for (int i = 0; i < MOST_FORCES && law->field != NOT_STIFFENING; i++) {
        stiffening_shift at = stiffening_at(law, force);
        double more = sought - law->linear * force - at.shift, slope = law->linear + at.slope;
        if (more <= SAME_FORCE * slope * force || slope <= RIGID * law->linear) break;
        force += more / slope;
    }
    return copysign(force, displacement);
}
