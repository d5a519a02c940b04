#include "tissue/node_order.h"

#include <stdlib.h>

cholmod_sparse *node_graph(tissue *t) {
    const int *start = t->stiffness->p, *row = t->stiffness->i;
    size_t nodes = (size_t)t->dof_count / 3;
    cholmod_triplet *pairs = cholmod_allocate_triplet(nodes, nodes, cholmod_nnz(t->stiffness, &t->common) / 3 + 1, -1, CHOLMOD_PATTERN, &t->common);
    if (!pairs) return NULL;
    for (int j = 0; j < (int)nodes; j++)
        for (int k = start[3 * j]; k < start[3 * j + 1]; k++) {
            if (row[k] % 3 != 0) continue;
            ((int *)pairs->i)[pairs->nnz] = row[k] / 3;
            ((int *)pairs->j)[pairs->nnz++] = j;
        }
    cholmod_sparse *graph = cholmod_triplet_to_sparse(pairs, 0, &t->common);
    cholmod_free_triplet(&pairs, &t->common);
    return graph;
}

bool *mark_free_nodes(const tissue *t, int count, const int *nodes) {
    bool *marked = calloc((size_t)t->dof_count / 3, sizeof *marked);
    for (int i = 0; marked && i < count; i++)
        if (t->dof[nodes[i]] >= 0) marked[t->dof[nodes[i]] / 3] = true;
    return marked;
}

bool node_order(tissue *t, cholmod_sparse *graph, const bool *last, int *order) {
    int nodes = t->dof_count / 3, filled = 0, *scratch = malloc(3 * (size_t)nodes * sizeof *scratch);
    bool done = scratch && cholmod_nested_dissection(graph, NULL, 0, scratch, scratch + nodes, scratch + 2 * nodes, &t->common) >= 0;
    for (int pass = 0; done && pass < 2; pass++)
        for (int i = 0; i < nodes; i++)
            if (last[scratch[i]] == (pass == 1)) order[filled++] = scratch[i];
    free(scratch);
    return done;
}

/* Returns the subgraph of these nodes as the lower triangle of its adjacency matrix. */
static cholmod_sparse *part_of(tissue *t, const cholmod_sparse *graph, int count, const int *nodes) {
    const int *start = graph->p, *row = graph->i;
    int *index = malloc(graph->nrow * sizeof *index);
    cholmod_triplet *pairs = cholmod_allocate_triplet((size_t)count, (size_t)count, (size_t)start[graph->ncol], -1, CHOLMOD_PATTERN, &t->common);
    cholmod_sparse *part = NULL;
    if (index && pairs) {
        for (size_t i = 0; i < graph->nrow; i++) index[i] = -1;
        for (int i = 0; i < count; i++) index[nodes[i]] = i;
        for (int j = 0; j < (int)graph->ncol; j++)
            for (int k = start[j]; k < start[j + 1]; k++) {
                int a = index[row[k]], b = index[j];
                if (a < 0 || b < 0) continue;
                ((int *)pairs->i)[pairs->nnz] = a > b ? a : b;
                ((int *)pairs->j)[pairs->nnz++] = a > b ? b : a;
            }
        part = cholmod_triplet_to_sparse(pairs, 0, &t->common);
    }
    cholmod_free_triplet(&pairs, &t->common);
    free(index);
    return part;
}

bool node_dissect(tissue *t, const cholmod_sparse *graph, int count, const int *nodes, int *order) {
    if (count == 0) return true;
    int *scratch = malloc(3 * (size_t)count * sizeof *scratch);
    cholmod_sparse *part = scratch ? part_of(t, graph, count, nodes) : NULL;
    bool done = part && cholmod_nested_dissection(part, NULL, 0, scratch, scratch + count, scratch + 2 * count, &t->common) >= 0;
    for (int i = 0; i < count && done; i++) order[i] = nodes[scratch[i]];
    cholmod_free_sparse(&part, &t->common);
    free(scratch);
    return done;
}
