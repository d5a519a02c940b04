#include "tissue/membrane_stiffness.h"

#include <string.h>

#include "base/hash.h"

/* With the in-plane gradients g of the shape functions, the unit normal n, and the Lame constants of plane stress integrated over the thickness, the block for
   nodes a and b is A (lambda ga gb^T + mu gb ga^T + mu (ga.gb) (I - n n^T)). This is the plane stress triangle of Zienkiewicz & Taylor, vol. 1, in any
   orientation in space. */
void triangle_stiffness(const vec3 corners[3], const membrane_material *material, double k[9][9]) {
    double nu = material->poisson_ratio, mu = material->stiffness / (2.0 * (1.0 + nu)), lambda = material->stiffness * nu / (1.0 - nu * nu);
    vec3 twice = v3_cross(v3_sub(corners[1], corners[0]), v3_sub(corners[2], corners[0])), g[3];
    double area = 0.5 * v3_norm(twice);
    vec3 normal = v3_scale(0.5 / area, twice);
    for (int a = 0; a < 3; a++) g[a] = v3_scale(0.5 / area, v3_cross(normal, v3_sub(corners[(a + 2) % 3], corners[(a + 1) % 3])));
    const double n[3] = {normal.x, normal.y, normal.z};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) {
            const double p[3] = {g[a].x, g[a].y, g[a].z}, q[3] = {g[b].x, g[b].y, g[b].z}, shear = mu * v3_dot(g[a], g[b]);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    k[3 * a + i][3 * b + j] = area * (lambda * p[i] * q[j] + mu * q[i] * p[j] + shear * ((i == j) - n[i] * n[j]));
        }
}

/* Returns a mask: bit g is set if groups[g] is a membrane with nonzero stiffness on this face. So that each face counts once, only the lower-numbered of its
   two tetrahedra gets a nonzero mask. */
static uint32_t membranes_on(const mesh *m, const membrane_material *materials, int tet, int face) {
    uint32_t found = 0;
    int other = m->neighbours[tet][face];
    for (uint32_t left = other < 0 || tet < other ? m->face_groups[tet][face] : 0; left; left &= left - 1) {
        int group = __builtin_ctz(left);
        if (materials[group].stiffness > 0.0) found |= UINT32_C(1) << group;
    }
    return found;
}

bool membrane_on_face(const mesh *m, const membrane_material *materials, int tet, int face, membrane_face *found) {
    uint32_t groups = materials ? membranes_on(m, materials, tet, face) : 0;
    if (!groups) return false;
    vec3 corners[3];
    for (int c = 0; c < 3; c++) {
        found->nodes[c] = m->tets[tet][(face + c + 1) % 4];
        corners[c] = m->nodes[found->nodes[c]];
    }
    memset(found->stiffness, 0, sizeof found->stiffness);
    for (; groups; groups &= groups - 1) {
        double k[9][9];
        triangle_stiffness(corners, &materials[__builtin_ctz(groups)], k);
        for (int a = 0; a < 9; a++)
            for (int b = 0; b < 9; b++) found->stiffness[a][b] += k[a][b];
    }
    return true;
}

int membrane_face_count(const mesh *m, const membrane_material *materials) {
    int count = 0;
    for (int i = 0; materials && i < 4 * m->tet_count; i++) count += membranes_on(m, materials, i / 4, i % 4) != 0;
    return count;
}

uint64_t membrane_hash(uint64_t h, const mesh *m, const membrane_material *materials) {
    for (int i = 0; materials && i < 4 * m->tet_count; i++)
        for (uint32_t groups = membranes_on(m, materials, i / 4, i % 4); groups; groups &= groups - 1) {
            const membrane_material *material = &materials[__builtin_ctz(groups)];
            const double values[] = {i, material->stiffness, material->poisson_ratio};
            h = hash_bytes(h, values, sizeof values);
        }
    return h;
}
