#include "refinement/refined_mesh.h"

#include <stdlib.h>
#include <string.h>

#include "refinement/leaves.h"

static int written_corner(const mesh *m, int corner) { return corner >= 0 ? corner : m->node_count - 1 - corner; }

/* Writes the leaves of one element. The first leaf takes the element's place; the others are appended. */
static void write_leaves(const mesh *m, const refinement *r, int tet, refined_mesh *out) {
    leaf leaves[MAX_LEAVES];
    int count = leaves_of(m, r, r->count, tet, leaves);
    for (int i = 0; i < count; i++) {
        int place = i == 0 ? tet : out->tet_count++;
        for (int c = 0; c < 4; c++) out->tets[place][c] = written_corner(m, leaves[i].corners[c]);
        out->parent[place] = tet;
    }
}

trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, trocar_error *why) {
    size_t nodes = (size_t)(m->node_count + r->count), tets = (size_t)(m->tet_count + 4 * r->count);
    *out = (refined_mesh){.node_count = (int)nodes, .tet_count = m->tet_count, .nodes = malloc(nodes * sizeof *out->nodes),
                          .tets = malloc(tets * sizeof *out->tets), .parent = malloc(tets * sizeof *out->parent)};
    if (!out->nodes || !out->tets || !out->parent) {
        refined_mesh_free(out);
        return fail(why, TROCAR_NO_MEMORY, "no memory for a refined mesh of %zu nodes", nodes);
    }
    memcpy(out->nodes, m->nodes, (size_t)m->node_count * sizeof *out->nodes);
    memcpy(out->tets, m->tets, (size_t)m->tet_count * sizeof *out->tets);
    for (int q = 0; q < r->count; q++) {
        out->nodes[m->node_count + q] = r->nodes[q].position;
        if (r->nodes[q].moved >= 0) out->nodes[r->nodes[q].moved] = r->nodes[q].position;
    }
    for (int e = 0; e < m->tet_count; e++) write_leaves(m, r, e, out);
    return TROCAR_OK;
}

void refined_mesh_free(refined_mesh *out) {
    free(out->nodes);
    free(out->tets);
    free(out->parent);
    memset(out, 0, sizeof *out);
}
