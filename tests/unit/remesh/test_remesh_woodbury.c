/* Tests Woodbury's formula on the dense inverse, stored as a triangle and as the full matrix. */
#include "remeshing.h"

int main(void) {
    static const remesh_method methods[] = {REMESH_WOODBURY, REMESH_WOODBURY_GENERAL};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods);
}
