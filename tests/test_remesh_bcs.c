/* Boundary-condition switches on the full inverse, one by one and in blocks. */
#include "remeshing.h"

int main(void) {
    static const remesh_method methods[] = {REMESH_BCS, REMESH_BCS_BLOCKED};
    return run_remeshing_tests(methods, sizeof methods / sizeof *methods);
}
