#include "linalg/symmetric_blocks.h"

size_t symmetric_blocks_numbers(int count) { return 9 * ((size_t)count * ((size_t)count + 1) / 2); }

size_t symmetric_blocks_bytes(int count, bool single) { return symmetric_blocks_numbers(count) * (single ? sizeof(float) : sizeof(double)); }

static size_t place(int row, int column) { return symmetric_blocks_numbers(row) + 9 * (size_t)column; }

void symmetric_blocks_get(const symmetric_blocks *m, int row, int column, double *out, int ld) {
    bool transposed = column > row;
    size_t at = transposed ? place(column, row) : place(row, column);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            size_t number = at + (size_t)(transposed ? 3 * b + a : 3 * a + b);
            out[(size_t)a * (size_t)ld + (size_t)b] = m->single ? (double)((const float *)m->numbers)[number] : ((const double *)m->numbers)[number];
        }
}

void symmetric_blocks_set(symmetric_blocks *m, int row, int column, const double block[9]) {
    size_t at = place(row, column);
    for (size_t k = 0; k < 9; k++) {
        if (m->single) ((float *)m->numbers)[at + k] = (float)block[k];
        else ((double *)m->numbers)[at + k] = block[k];
    }
}
