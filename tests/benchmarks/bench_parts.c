/* Benchmarks for parts of the library that trocar.h cannot time: each remeshing method, and how late each contact node becomes active. */
#include "bench/bench_main.h"
#include "bench_remesh.h"
#include "bench_scale.h"
#include "shared/options.h"

const char *argp_program_version = "bench_parts " TROCAR_VERSION;
error_t argp_err_exit_status = EXIT_BAD_INPUT;

int main(int count, char **arguments) {
    static const benchmark all[] = {{"bench_parts remesh", bench_remesh}, {"bench_parts scale", bench_scale}};
    return bench_main(count, arguments, all, 2,
                      "Times parts of the library relative to a matrix product, so that machines can be compared by ratios."
                      "\vBenchmarks ('bench_parts BENCHMARK --help' shows the options of one):\n\n"
                      "  remesh  adding or removing a contact node against the size of the mesh and the node's valence, by every method\n"
                      "  scale   an insertion against the size of the mesh, for each owner of the inverse");
}
