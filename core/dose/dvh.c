/* Implements the dose-volume histograms in trocar/dose.h. */
#include <math.h>
#include <stdlib.h>

#include "base/error.h"

static int larger_first(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x < y) - (x > y);
}

trocar_status trocar_dvh_sort(double *doses, int64_t count, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (count < 1) return fail(why, TROCAR_BAD_INPUT, "a dose-volume histogram without voxels: expected at least one dose");
    for (int64_t i = 0; i < count; i++)
        if (!isfinite(doses[i])) return fail(why, TROCAR_BAD_INPUT, "dose %lld is %g: expected a finite number", (long long)i, doses[i]);
    qsort(doses, (size_t)count, sizeof *doses, larger_first);
    return TROCAR_OK;
}

/* Each voxel covers a fraction 1 / count of the volume; its dose is taken to apply at the middle of that fraction. */
double trocar_dvh_dose(const double *doses, int64_t count, double fraction) {
    double last = (double)(count - 1), at = fraction * (double)count - 0.5;
    at = at > 0.0 ? at < last ? at : last : 0.0;
    int64_t before = (int64_t)at, after = before + 1 < count ? before + 1 : before;
    return doses[before] + (at - (double)before) * (doses[after] - doses[before]);
}

double trocar_dvh_volume(const double *doses, int64_t count, double dose) {
    int64_t low = 0, high = count; /* voxels before `low` receive at least `dose`, those from `high` on receive less */
    while (low < high) {
        int64_t middle = low + (high - low) / 2;
        if (doses[middle] >= dose) low = middle + 1;
        else high = middle;
    }
    return (double)low / (double)count;
}

trocar_dvh_summary trocar_dvh_summarise(const double *doses, int64_t count, double voxel_volume, double prescription) {
    double sum = 0.0;
    for (int64_t i = count - 1; i >= 0; i--) sum += doses[i];
    trocar_dvh_summary s = {.volume_cm3 = 1e6 * voxel_volume * (double)count, .mean = sum / (double)count, .minimum = doses[count - 1], .maximum = doses[0],
                            .d10 = trocar_dvh_dose(doses, count, 0.1), .d30 = trocar_dvh_dose(doses, count, 0.3),
                            .d80 = trocar_dvh_dose(doses, count, 0.8), .d90 = trocar_dvh_dose(doses, count, 0.9),
                            .v100 = trocar_dvh_volume(doses, count, prescription), .v150 = trocar_dvh_volume(doses, count, 1.5 * prescription),
                            .v200 = trocar_dvh_volume(doses, count, 2.0 * prescription)};
    s.v100_cm3 = s.v100 * s.volume_cm3;
    return s;
}
