/* The implicit low-rank form. */
#include "remeshing.h"

int main(void) {
    static const remesh_method methods[] = {REMESH_IMPLICIT};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods);
}
