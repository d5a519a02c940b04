#include "tissue/sliding_stiffness.h"

#include "base/hash.h"

mat3 pair_stiffness(const node_pair *pair, const sliding_material *materials) {
    const sliding_material *material = &materials[pair->group];
    const double n[3] = {pair->normal.x, pair->normal.y, pair->normal.z};
    mat3 k;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) k.m[i][j] = pair->area * (material->shear * (i == j) + (material->normal - material->shear) * n[i] * n[j]);
    return k;
}

uint64_t sliding_hash(uint64_t h, const mesh *m, const sliding_material *materials) {
    for (int i = 0; i < m->pair_count; i++) {
        const node_pair *pair = &m->pairs[i];
        const sliding_material *material = &materials[pair->group];
        const double values[] = {pair->nodes[0], pair->nodes[1], pair->normal.x, pair->normal.y, pair->normal.z, pair->area, material->normal, material->shear};
        h = hash_bytes(h, values, sizeof values);
    }
    return h;
}
