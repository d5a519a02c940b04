/* Comparisons in double precision; cmocka's own use float. Include after cmocka.h. */
#ifndef TROCAR_TESTS_CHECK_H
#define TROCAR_TESTS_CHECK_H

#include <math.h>
#include <string.h>

static inline void check_close(double a, double b, double tolerance, int line) {
    if (!(fabs(a - b) <= tolerance)) fail_msg("line %d: %.17g and %.17g differ by more than %g", line, a, b, tolerance);
}
#define assert_close(a, b, tolerance) check_close(a, b, tolerance, __LINE__)
#define assert_close_vector(a, b, tolerance) check_close(v3_norm(v3_sub(a, b)), 0.0, tolerance, __LINE__)

#endif
