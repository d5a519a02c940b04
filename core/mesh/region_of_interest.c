#include "mesh/region_of_interest.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

bool roi_given(const roi_config *given) { return given->region_count > 0 || given->radius > 0.0; }

static double distance_to_segment(vec3 x, vec3 from, vec3 to) {
    vec3 way = v3_sub(to, from), off = v3_sub(x, from);
    double along = v3_dot(off, way) / v3_dot(way, way);
    return v3_norm(v3_axpy(-fmin(fmax(along, 0.0), 1.0), way, off));
}

static trocar_status mark_given(const mesh *m, const roi_config *given, bool *inside, trocar_error *why) {
    bool any = false;
    for (int r = 0; r < given->region_count; r++) {
        int group = mesh_find_group(m, given->regions[r], 3);
        if (group < 0) return fail(why, TROCAR_BAD_INPUT, "region_of_interest.regions: the mesh has no region \"%s\"", given->regions[r]);
        for (int k = 0; k < m->groups[group].node_count; k++) any = inside[m->groups[group].nodes[k]] = true;
    }
    for (int i = 0; i < m->node_count && given->radius > 0.0; i++)
        if (distance_to_segment(m->nodes[i], given->from, given->to) <= given->radius) any = inside[i] = true;
    return any ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "region_of_interest contains no node of the mesh: increase the radius of the corridor");
}

/* ---- default region ---------------------------------------------------------------------------------------------------- */

typedef struct { vec3 point, direction; } line;

/* Returns the inward normal through the centroid of an outer surface. Its direction is zero if there is no such surface, or if it is closed. */
static line line_into(const mesh *m, int surface) {
    double area = 0.0;
    vec3 middle = v3(0, 0, 0), outwards = v3(0, 0, 0);
    for (int b = 0; b < m->boundary_count && surface >= 0; b++) {
        const boundary_face *face = &m->boundary[b];
        if (!(m->face_groups[face->tet][face->face] >> surface & 1)) continue;
        vec3 p = m->nodes[face->nodes[0]], q = m->nodes[face->nodes[1]], r = m->nodes[face->nodes[2]];
        vec3 normal = v3_cross(v3_sub(q, p), v3_sub(r, p));
        area += v3_norm(normal);
        middle = v3_axpy(v3_norm(normal) / 3.0, v3_add(p, v3_add(q, r)), middle);
        outwards = v3_add(outwards, normal);
    }
    bool flat = v3_norm(outwards) > 0.1 * area; /* true for an open, roughly flat surface; false for a closed one */
    return flat ? (line){v3_scale(1.0 / area, middle), v3_scale(-1.0 / v3_norm(outwards), outwards)} : (line){.direction = v3(0, 0, 0)};
}

typedef struct { double distance; int node; } ranked_node;

static int by_distance(const void *a, const void *b) {
    const ranked_node *p = a, *q = b;
    return p->distance != q->distance ? (p->distance > q->distance) - (p->distance < q->distance) : p->node - q->node;
}

static trocar_status mark_usual(const mesh *m, int surface, bool *inside, trocar_error *why) {
    line axis = line_into(m, surface);
    bool all = m->node_count <= REACH_USUAL, known = v3_norm(axis.direction) > 0.0;
    ranked_node *ranked = malloc((size_t)m->node_count * sizeof *ranked);
    if (!ranked) return fail(why, TROCAR_NO_MEMORY, "no memory for %d nodes", m->node_count);
    for (int i = 0; i < m->node_count; i++)
        ranked[i] = (ranked_node){v3_norm(v3_cross(axis.direction, v3_sub(m->nodes[i], axis.point))), i};
    qsort(ranked, (size_t)m->node_count, sizeof *ranked, by_distance);
    for (int i = 0; i < m->node_count && (all || (known && i < REACH_USUAL)); i++) inside[ranked[i].node] = true;
    free(ranked);
    return TROCAR_OK;
}

trocar_status roi_find(const mesh *m, const roi_config *given, int surface, int **nodes, int *count, trocar_error *why) {
    bool *inside = calloc((size_t)m->node_count, sizeof *inside);
    *nodes = malloc((size_t)m->node_count * sizeof **nodes);
    *count = 0;
    trocar_status status = inside && *nodes ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %d nodes", m->node_count);
    if (status == TROCAR_OK) status = roi_given(given) ? mark_given(m, given, inside, why) : mark_usual(m, surface, inside, why);
    for (int i = 0; i < m->node_count && status == TROCAR_OK; i++)
        if (inside[i]) (*nodes)[(*count)++] = i;
    free(inside);
    if (status == TROCAR_OK) return TROCAR_OK;
    free(*nodes);
    *nodes = NULL;
    return status;
}
