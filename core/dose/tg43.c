/* D(r, theta) = S_K Lambda G(r, theta) / G(1 cm, 90 degrees) g(r) F(r, theta), with G = beta / (L r sin theta): AAPM TG-43U1 (Rivard et al., Med. Phys. 31,
   2004), equations 1 and 4. Interpolation and extrapolation follow TG-43U1S1 (Rivard et al., Med. Phys. 34, 2007): log g is linear in r, even beyond the last
   radius, and constant below the first; F is bilinear, and outside the table it takes the value at the nearest tabulated radius.
   To evaluate the formula at a million grid points in a few tens of milliseconds, points are processed in blocks, in loops without branches or calls that
   compilers can vectorise, and arctangent and exponential are approximated by polynomials. Only the table lookup goes point by point; it is fast because
   neighbouring points are mostly in the same cell. */
#include "dose/tg43.h"

#include <stdint.h>
#include <string.h>

#define PI 3.14159265358979323846

/* Returns atan(t) / t for 0 <= t <= 1, using a polynomial in t^2 from Chebyshev interpolation; relative error 3e-13. */
static inline double atan_over(double t) {
    static const double c[] = {0.99999999999970868, -0.33333333320218178, 0.19999999010798106, -0.14285684590526901, 0.11110639811092729,
                               -0.090863525638637088, 0.076631340347004584, -0.065360715956921916, 0.054578423928493672, -0.042317565110958334,
                               0.028401842079862641, -0.015225017280317842, 0.0059322190470993521, -0.001465309535463651, 0.00017026240626970927};
    double s = t * t, sum = c[14];
    for (int i = 13; i >= 0; i--) sum = sum * s + c[i];
    return sum;
}

/* Returns exp(x) for -700 <= x <= 700: 2^n times the Taylor series of exp(x - n ln 2); relative error 1e-14. */
static inline double exponential(double x) {
    const double round = 0x1.8p52; /* adding this rounds a number to an integer, found in the last bits of the sum */
    double shifted = x * 1.44269504088896340736 + round, n = shifted - round;
    double rest = (x - n * 0x1.62e42fefa38p-1) - n * 0x1.ef35793c7673p-45; /* ln 2, split into two parts */
    double sum = 1.0 / 39916800.0;
    static const double c[] = {1.0, 1.0, 1.0 / 2, 1.0 / 6, 1.0 / 24, 1.0 / 120, 1.0 / 720, 1.0 / 5040, 1.0 / 40320, 1.0 / 362880, 1.0 / 3628800};
    for (int i = 10; i >= 0; i--) sum = sum * rest + c[i];
    int64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (int64_t)((uint64_t)bits << 52) + INT64_C(0x3ff0000000000000);
    double power;
    memcpy(&power, &bits, sizeof power);
    return sum * power;
}

/* Returns the index i, 0 <= i < count, of the interval start[i] <= x < start[i + 1]. The search starts at the given i. */
static inline int walk(const double *start, int count, int i, double x) {
    while (i + 1 < count && x >= start[i + 1]) i++;
    while (i > 0 && x < start[i]) i--;
    return i;
}

/* Returns the angle (rad) between the x axis and the vector (x, y), where y >= 0. */
static inline double angle_of(double x, double y) {
    double across = fabs(x), low = y < across ? y : across, high = y < across ? across : y, t = low / high, a = t * atan_over(t);
    a = y > across ? 0.5 * PI - a : a;
    return x < 0.0 ? PI - a : a;
}

/* Returns beta / (L rho) at a point `radius` from the centre and rho from the axis of a line source of length L, where beta = atan2(L rho,
   radius^2 - L^2 / 4). Finite on the axis beyond the ends of the source. */
static inline double geometry(double length, double rho, double radius_squared) {
    double y = length * rho, x = radius_squared - 0.25 * length * length, across = fabs(x);
    double low = y < across ? y : across, high = y < across ? across : y, q = atan_over(low / high), a = low / high * q;
    double wide = (y > across ? 0.5 * PI - a : a);
    double beta = x < 0.0 ? PI - wide : wide;
    return y <= x ? q / x : beta / y;
}

void tg43_rates(const trocar_dose_source *s, const seed_place *seed, const double *x, const double *y, const double *z, int count, double *rate) {
    double radius[TG43_BLOCK], degrees[TG43_BLOCK], geometric[TG43_BLOCK], log_g[TG43_BLOCK], f[TG43_BLOCK];
    const vec3 c = seed->centre, a = seed->axis;
    const double length = s->active_length, half = 0.5 * s->capsule_length, wall = 0.5 * s->capsule_diameter;
    const double scale = 0.01 * s->dose_rate_constant / geometry(length, 1.0, 1.0); /* converts cGy to Gy */

    /* Computes cylindrical coordinates in cm, then r, theta and G. */
    for (int i = 0; i < count; i++) {
        double dx = 100.0 * (x[i] - c.x), dy = 100.0 * (y[i] - c.y), dz = 100.0 * (z[i] - c.z);
        double along = dx * a.x + dy * a.y + dz * a.z;
        double px = dy * a.z - dz * a.y, py = dz * a.x - dx * a.z, pz = dx * a.y - dy * a.x;
        double rho = sqrt(px * px + py * py + pz * pz);
        double outside = rho > wall ? rho : wall;
        rho = fabs(along) <= half ? outside : rho;
        double squared = rho * rho + along * along;
        radius[i] = sqrt(squared);
        degrees[i] = angle_of(along, rho) * (180.0 / PI);
        geometric[i] = geometry(length, rho, squared);
    }
    for (int i = 0, piece = 0, sector = 0; i < count; i++) {
        piece = walk(s->start, s->piece_count, piece, radius[i]);
        sector = walk(s->angle, s->angle_count - 1, sector, degrees[i]);
        const anisotropy_cell *cell = &s->cells[piece * (s->angle_count - 1) + sector];
        log_g[i] = s->intercept[piece] + s->slope[piece] * radius[i];
        f[i] = cell->a + cell->b * degrees[i] + radius[i] * (cell->c + cell->d * degrees[i]);
    }
    for (int i = 0; i < count; i++) {
        double exponent = log_g[i] < -700.0 ? -700.0 : log_g[i];
        rate[i] = scale * geometric[i] * exponential(exponent) * f[i];
    }
}
