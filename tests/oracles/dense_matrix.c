#include "oracles/dense_matrix.h"

#include <stdlib.h>
#include <string.h>

bool is_dense(const inverse *inv) { return strcmp(inverse_name(inv), "dense") == 0; }

double *dense_matrix(inverse *inv) {
    const tissue *t = inverse_tissue(inv);
    size_t n = (size_t)t->dof_count;
    double *matrix = malloc(n * n * sizeof *matrix);
    int *nodes = malloc(n / 3 * sizeof *nodes);
    trocar_error why;
    for (int i = 0; nodes && i < t->mesh->node_count; i++)
        if (t->dof[i] >= 0) nodes[t->dof[i] / 3] = i;
    bool found = matrix && nodes && inverse_gather(inv, &(inverse_blocks){(int)n / 3, nodes, (int)n / 3, nodes, matrix, (int)n}, &why) == TROCAR_OK;
    free(nodes);
    if (found) return matrix;
    free(matrix);
    return NULL;
}
