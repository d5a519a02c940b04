/* Tests the implicit low-rank form of the update. */
#include "remeshing.h"

int main(void) {
    static const int methods[] = {REMESH_IMPLICIT};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods);
}
