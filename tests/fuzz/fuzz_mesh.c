/* A mesh that is syntactically valid (Gmsh's own parser is not under test) but arbitrary otherwise: the input determines nodes and
   elements. Either it is refused, or all indices are in range and all tetrahedra have positive orientation. */
#include "fuzz.h"

#include <math.h>

#include "mesh/mesh.h"

/* Gmsh leaks when it gives up in the middle of a file. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:libgmsh\nleak:libstdc++\n"; }

enum { MAX_NODES = 12, MAX_ELEMENTS = 24, NODE_BYTES = 4, ELEMENT_BYTES = 6 };

static void write_nodes(FILE *text, const uint8_t *data, int count) {
    fprintf(text, "$Nodes\n%d\n", count);
    for (int i = 0; i < count; i++, data += NODE_BYTES) {
        double scale = data[0] == 255 ? 1e300 : data[0] == 254 ? 1e-300 : 1; /* products overflow or underflow */
        fprintf(text, "%d %g %g %g\n", i + 1 + (data[0] & 1), scale * data[1], scale * data[2], scale * data[3]);
    }
    fprintf(text, "$EndNodes\n");
}

/* Points, lines, triangles and tetrahedra of groups 1..4; a few refer to missing nodes, which Gmsh must handle. */
static void write_elements(FILE *text, const uint8_t *data, int count, int nodes) {
    static const int types[] = {15, 1, 2, 4};
    fprintf(text, "$Elements\n%d\n", count);
    for (int i = 0; i < count; i++, data += ELEMENT_BYTES) {
        int corners = 1 + data[0] % 4, group = data[1] % 5;
        fprintf(text, "%d %d 2 %d %d", i + 1, types[corners - 1], group, 1 + data[1] / 5 % 3);
        for (int c = 0; c < corners; c++) fprintf(text, " %d", 1 + data[2 + c] % nodes);
        fprintf(text, "\n");
    }
    fprintf(text, "$EndElements\n");
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
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 2) return 0;
    int nodes = 1 + data[0] % MAX_NODES, elements = 1 + data[1] % MAX_ELEMENTS;
    if (size < 2 + (size_t)(nodes * NODE_BYTES + elements * ELEMENT_BYTES)) return 0;
    static char text[16384];
    FILE *out = fmemopen(text, sizeof text, "w");
    fprintf(out, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n0 1 \"held\"\n2 2 \"skin\"\n3 3 \"body\"\n$EndPhysicalNames\n");
    write_nodes(out, data + 2, nodes);
    write_elements(out, data + 2 + nodes * NODE_BYTES, elements, nodes);
    long length = ftell(out);
    fclose(out);

    char path[] = "/dev/shm/fuzz_mesh.XXXXXX.msh"; /* Gmsh selects the format by the extension */
    int file = mkstemps(path, 4);
    REQUIRE(file >= 0 && write(file, text, (size_t)length) == length && close(file) == 0);
    mesh m;
    report why = {""};
    trocar_status status = mesh_read(path, &m, &why);
    unlink(path);
    REQUIRE(status == TROCAR_OK || why.text[0] != '\0');
    if (status == TROCAR_OK) {
        check(&m);
        mesh_free(&m);
    }
    return 0;
}
