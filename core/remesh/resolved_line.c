#include "remesh/resolved_line.h"

#include <string.h>

/* Finds where the line enters and leaves its element, as distances (m) along the line from its point. Both are 0 if the line only touches a corner or an edge.
   */
static void clip(const mesh *m, const line_in_tet *line, double *from, double *to) {
    double here[4], there[4], unit = m->node_size[m->tets[line->tet][0]];
    *from = -INFINITY;
    *to = INFINITY;
    mesh_barycentric(m, line->tet, line->point, here);
    mesh_barycentric(m, line->tet, v3_axpy(unit, line->direction, line->point), there);
    for (int c = 0; c < 4; c++) {
        double slope = (there[c] - here[c]) / unit;
        if (slope > 0.0) *from = fmax(*from, -here[c] / slope);
        if (slope < 0.0) *to = fmin(*to, -here[c] / slope);
    }
    if (!(*from < *to)) *from = *to = 0.0;
}

static trocar_status measure_piece(remesher *r, const line_in_tet *line, line_piece *piece, trocar_error *why) {
    double from, to;
    vec3 x[MAX_RESOLVED];
    clip(r->tissue->mesh, line, &from, &to);
    for (int k = 0; k < MAX_RESOLVED; k++) x[k] = v3_axpy(from + 0.5 * k * (to - from), line->direction, line->point);
    *piece = (line_piece){.line = *line, .length = to - from, .start = x[0]};
    return resolver_measure(r->resolver, line->tet, line->direction, MAX_RESOLVED, x, piece->at, why);
}

/* Returns the piece measured on exactly this line, or NULL. A similar line will not do, because answers must not depend on earlier requests. */
static const line_piece *find_piece(const remesher *r, const line_in_tet *line) {
    for (int i = 0; i < r->piece_count; i++)
        if (line_same(&r->pieces[i].line, line)) return &r->pieces[i];
    return NULL;
}

bool lines_are_new(const remesher *r, const remesh_request *request) {
    for (int i = 0; i < request->piece_count; i++)
        if (!find_piece(r, &request->pieces[i])) return true;
    return false;
}

trocar_status resolve_pieces(remesher *r, const remesh_request *request, int most, trocar_error *why) {
    line_piece pieces[MAX_PIECES];
    int count = 0;
    for (int i = 0; i < request->piece_count; i++) {
        const line_piece *known = find_piece(r, &request->pieces[i]);
        if (known) {
            pieces[count++] = *known;
        } else if (most-- > 0) {
            trocar_status status = measure_piece(r, &request->pieces[i], &pieces[count++], why);
            if (status != TROCAR_OK) return status;
        }
    }
    r->piece_count = count;
    memcpy(r->pieces, pieces, (size_t)count * sizeof *pieces);
    return TROCAR_OK;
}

void set_resolved(remesher *r, int slot, const resolved_field *resolved) {
    r->resolved[slot] = *resolved;
    r->measured[slot].line = r->refined.nodes[slot].line;
    r->measured[slot].at = r->refined.nodes[slot].position;
}

/* If the node has been measured at this position on this line, the result is reused: after a change to the inverse, all nodes are added again at the same
   positions. */
trocar_status resolve_contact(remesher *r, int slot, trocar_error *why) {
    const added_node *node = &r->refined.nodes[slot];
    line_in_tet line = node->line;
    if (v3_norm(line.direction) == 0.0) {
        set_resolved(r, slot, &(resolved_field){0});
        return TROCAR_OK;
    }
    if (line_same(&r->measured[slot].line, &line) && v3_same(r->measured[slot].at, node->position)) return TROCAR_OK;
    const line_piece *known = find_piece(r, &line);
    line_piece measured;
    trocar_status status = known ? TROCAR_OK : measure_piece(r, &line, &measured, why);
    if (status != TROCAR_OK) return status;
    if (!known && r->piece_count < MAX_PIECES) r->pieces[r->piece_count++] = measured; /* keep it, because a request often contains the same line more than once
                                                                                          */
    resolved_field resolved = piece_at(known ? known : &measured, node->position);
    set_resolved(r, slot, &resolved);
    return TROCAR_OK;
}
