/* Reads a mesh file, MSH 2.2 or 4.1, text or binary. Either it is refused with a message, or all indices are in range and all tetrahedra have positive
   orientation. Other formats are refused, because Gmsh's own readers are not under test. */
#include "fuzz.h"

#include "mesh/mesh.h"

/* Simulates a machine without Gmsh. */
void *__wrap_dlopen(const char *path, int flags);
void *__wrap_dlopen(const char *path, int flags) {
    (void)path;
    (void)flags;
    return NULL;
}

static void check(const mesh *m) {
    REQUIRE(m->node_count >= 4 && m->tet_count >= 1);
    for (int t = 0; t < m->tet_count; t++) {
        for (int c = 0; c < 4; c++) REQUIRE(m->tets[t][c] >= 0 && m->tets[t][c] < m->node_count);
        const vec3 *x = m->nodes;
        const int *n = m->tets[t];
        vec3 a = v3_sub(x[n[1]], x[n[0]]), b = v3_sub(x[n[2]], x[n[0]]), c = v3_sub(x[n[3]], x[n[0]]);
        REQUIRE(v3_dot(v3_cross(a, b), c) > 0);
        REQUIRE(m->region[t] >= 0 && m->region[t] < m->group_count);
    }
    for (int g = 0; g < m->group_count; g++)
        for (int i = 0; i < m->groups[g].node_count; i++) REQUIRE(m->groups[g].nodes[i] >= 0 && m->groups[g].nodes[i] < m->node_count);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    mesh m;
    trocar_error why = {""};
    trocar_status status = mesh_read(file_of(data, size), &m, &why);
    REQUIRE(status == TROCAR_OK || why.text[0] != '\0');
    if (status == TROCAR_OK) {
        check(&m);
        mesh_free(&m);
    }
    return 0;
}
