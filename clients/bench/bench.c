/* trocar-bench: measures the speed of the simulation through trocar.h. The benchmarks in tests/benchmarks/ measure individual parts of the
   library. */
#include "bench/bench_dose.h"
#include "bench/bench_features.h"
#include "bench/bench_main.h"
#include "bench/bench_tick.h"
#include "shared/options.h"

const char *argp_program_version = "trocar-bench " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

int main(int count, char **arguments) {
    static const benchmark all[] = {{"trocar-bench tick", bench_tick}, {"trocar-bench features", bench_features}, {"trocar-bench dose", bench_dose}};
    return bench_main(count, arguments, all, 3,
                      "Times the simulation relative to a matrix product, so that machines can be compared by ratios."
                      "\vBenchmarks ('trocar-bench BENCHMARK --help' shows the options of one):\n\n"
                      "  tick      a tick of the haptic loop against the number of contacts\n"
                      "  features  a tick with relaxation, a guide and turning against one without\n"
                      "  dose      a brachytherapy seed on a dose grid");
}
