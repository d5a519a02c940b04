/* A 40 mm cube divided into boxes of five tetrahedra each, both as arrays and as a Gmsh file. The skin is at z = 0; the face at z = 40 mm is fixed. */
#ifndef TROCAR_CUBE_MESH_H
#define TROCAR_CUBE_MESH_H

#include <stdio.h>
#include <trocar.h>

enum { BOXES = 5, SIDE = BOXES + 1, CUBE_NODES = SIDE * SIDE * SIDE, CUBE_TETS = 5 * BOXES * BOXES * BOXES, CUBE_TRIANGLES = 4 * BOXES * BOXES };

typedef struct {
    double nodes[CUBE_NODES][3];
    int32_t tets[CUBE_TETS][4], triangles[CUBE_TRIANGLES][3], triangle_surface[CUBE_TRIANGLES];
    int triangle_count;
} cube_mesh;

static int32_t cube_node(int x, int y, int z) { return x + SIDE * (y + SIDE * z); }

static void add_triangle(cube_mesh *c, int a, int b, int d, int surface) {
    int32_t *t = c->triangles[c->triangle_count];
    t[0] = a, t[1] = b, t[2] = d;
    c->triangle_surface[c->triangle_count++] = surface;
}

/* Splits a box into five tetrahedra. Every other box is mirrored, so that the face diagonals of neighbouring boxes match. */
static void fill_box(cube_mesh *c, int x, int y, int z, int32_t (*tet)[4]) {
    static const int CORNERS[2][5][4] = {{{0, 1, 3, 5}, {0, 3, 2, 6}, {0, 5, 6, 4}, {3, 6, 5, 7}, {0, 3, 6, 5}},
                                         {{1, 0, 4, 2}, {1, 2, 7, 3}, {1, 4, 5, 7}, {2, 4, 7, 6}, {1, 2, 4, 7}}};
    int odd = (x + y + z) % 2, n[8];
    for (int k = 0; k < 8; k++) n[k] = cube_node(x + k % 2, y + k / 2 % 2, z + k / 4);
    for (int t = 0; t < 5; t++)
        for (int k = 0; k < 4; k++) tet[t][k] = n[CORNERS[odd][t][k]];
    if (z == 0) { /* the bottom face's diagonal joins corners 0 and 3 in even boxes, 1 and 2 in odd ones */
        add_triangle(c, n[0], n[1], n[odd ? 2 : 3], 0);
        add_triangle(c, n[odd ? 1 : 0], n[odd ? 2 : 3], n[odd ? 3 : 2], 0);
    }
    if (z == BOXES - 1) {
        add_triangle(c, n[4], n[5], n[odd ? 7 : 6], 1);
        add_triangle(c, n[odd ? 4 : 5], n[6], n[7], 1);
    }
}

static inline void cube_create(cube_mesh *c) {
    c->triangle_count = 0;
    for (int z = 0; z < SIDE; z++)
        for (int y = 0; y < SIDE; y++)
            for (int x = 0; x < SIDE; x++) {
                double *p = c->nodes[cube_node(x, y, z)];
                p[0] = 0.008 * x - 0.02, p[1] = 0.008 * y - 0.02, p[2] = 0.008 * z;
            }
    int box = 0;
    for (int z = 0; z < BOXES; z++)
        for (int y = 0; y < BOXES; y++)
            for (int x = 0; x < BOXES; x++) fill_box(c, x, y, z, &c->tets[5 * box++]);
}

static inline trocar_mesh cube_arrays(const cube_mesh *c) {
    static const char *const regions[] = {"body"}, *const surfaces[] = {"skin", "back"};
    return (trocar_mesh){.node_count = CUBE_NODES, .tet_count = CUBE_TETS, .nodes = c->nodes[0], .tets = c->tets[0], .region_count = 1,
                         .regions = regions, .triangle_count = c->triangle_count, .triangles = c->triangles[0],
                         .triangle_surface = c->triangle_surface, .surface_count = 2, .surfaces = surfaces};
}

static inline void cube_write(const cube_mesh *c, const char *path) {
    FILE *f = fopen(path, "w");
    fprintf(f, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 1 \"skin\"\n2 2 \"back\"\n3 3 \"body\"\n$EndPhysicalNames\n$Nodes\n%d\n", CUBE_NODES);
    for (int i = 0; i < CUBE_NODES; i++) fprintf(f, "%d %.17g %.17g %.17g\n", i + 1, c->nodes[i][0], c->nodes[i][1], c->nodes[i][2]);
    fprintf(f, "$EndNodes\n$Elements\n%d\n", c->triangle_count + CUBE_TETS);
    for (int i = 0; i < c->triangle_count; i++)
        fprintf(f, "%d 2 2 %d %d %d %d %d\n", i + 1, c->triangle_surface[i] + 1, c->triangle_surface[i] + 1, c->triangles[i][0] + 1,
                c->triangles[i][1] + 1, c->triangles[i][2] + 1);
    for (int i = 0; i < CUBE_TETS; i++)
        fprintf(f, "%d 4 2 3 3 %d %d %d %d\n", c->triangle_count + i + 1, c->tets[i][0] + 1, c->tets[i][1] + 1, c->tets[i][2] + 1, c->tets[i][3] + 1);
    fprintf(f, "$EndElements\n");
    fclose(f);
}

#endif
