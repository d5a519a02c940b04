/* Tests the implicit low-rank form of the update. */
#include "remeshing.h"

int main(void) {
    static const remesh_method methods[] = {REMESH_IMPLICIT};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods);
}
