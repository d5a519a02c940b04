/* Reads a seed's dose table. Either it is refused with a message that begins with the file's name, or the dose is finite and not negative everywhere. */
#include "fuzz.h"

#include <math.h>
#include <string.h>

#include "dose/tg43.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static trocar_dose_source s;
    static const double x[] = {0, 0, 1e-6, 1e-3, 0.03, -0.2, 1000}, y[] = {0, 0, 0, 2e-3, -0.01, 0.1, 1000}, z[] = {0, 0.01, -0.05, 1e-4, 0.02, -0.3, -1000};
    enum { POINTS = sizeof x / sizeof *x };
    double rate[POINTS];
    trocar_error why = {""};
    if (dose_source_read("table", (const char *)data, size, &s, &why) != TROCAR_OK) {
        REQUIRE(strncmp(why.text, "table:", 6) == 0);
        return 0;
    }
    tg43_rates(&s, &(seed_place){v3(0, 0, 0), v3(0, 0, 1)}, x, y, z, POINTS, rate);
    for (int i = 0; i < POINTS; i++) REQUIRE(isfinite(rate[i]) && rate[i] > -1e-9 * fabs(rate[0]));
    dose_source_clear(&s);
    return 0;
}
