/* Checks that the forces of the figure-8 motion do not depend on the tick rate, the number of equilibrium iterations, or the remeshing method. */
#include "figure8.h"
#include "rows.h"

static void compare(rows *r, const char *what, const figure8_record *a, const char *reference, const figure8_record *b, double shift, double limit) {
    char check[160];
    snprintf(check, sizeof check, "%s: force", what);
    rows_error(r, check, reference, figure8_difference(a, b, 0, 3, shift), limit);
    snprintf(check, sizeof check, "%s: torque", what);
    rows_error(r, check, reference, figure8_difference(a, b, 3, 6, shift), limit);
    snprintf(check, sizeof check, "%s: punctures", what);
    rows_compare(r, check, reference, a->punctures, b->punctures, 0.0, NULL);
}

/* Punctures may fall in neighbouring ticks, so each force is compared with the other run's forces within one slowest period before and after. */
static void check_rates(rows *r) {
    simulation_config c = lockstep_config();
    figure8_record *reference = figure8_run(&c, 4000, 1);
    for (double rate = 250; rate < 4000; rate *= 2) {
        if (r->short_form && rate != 1000) continue;
        char what[40];
        snprintf(what, sizeof what, "%g Hz", rate);
        figure8_record *run = figure8_run(&c, rate, 1);
        compare(r, what, run, "4 kHz, over the peak", reference, FIGURE8_SLOWEST_PERIOD, 0.01);
        free(run);
    }
    free(reference);
}

static void check_passes(rows *r) {
    simulation_config c = lockstep_config();
    figure8_record *standard = figure8_run(&c, 1000, 1);
    c.insertion.max_passes = 12;
    c.insertion.tolerance = 1e-12;
    figure8_record *converged = figure8_run(&c, 1000, 1);
    compare(r, "4 passes at most, to 1e-8 m, as by default", standard, "12 passes, to 1e-12 m", converged, 0.0, 0.01);
    for (int passes = 1; passes <= 4 && !r->short_form; passes *= 2) {
        char what[40];
        snprintf(what, sizeof what, "%d pass%s, to 1e-12 m", passes, passes > 1 ? "es at most" : "");
        c.insertion.max_passes = passes;
        figure8_record *run = figure8_run(&c, 1000, 1);
        compare(r, what, run, "12 passes, to 1e-12 m", converged, 0.0, 0.01);
        free(run);
    }
    free(standard);
    free(converged);
}

static void check_remeshing(rows *r) {
    simulation_config c = lockstep_config();
    figure8_record *nested = figure8_run(&c, 500, 1);
    figure8_record *woodbury = figure8_run_by(REMESH_WOODBURY, &c, 500, 1);
    compare(r, "remeshing by Woodbury's formula", woodbury, "nested refinement", nested, 0.0, 1e-6);
    c.inverse = INVERSE_SPARSE;
    figure8_record *sparse = figure8_run(&c, 500, 1);
    compare(r, "columns of the inverse from a sparse factor", sparse, "dense inverse", nested, 0.0, 1e-6);
    free(nested);
    free(woodbury);
    free(sparse);
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: independence of rate, iterations and method");
    check_rates(&r);
    check_passes(&r);
    if (!r.short_form) check_remeshing(&r);
    return rows_end(&r);
}
