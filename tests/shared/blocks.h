/* Test bodies: blocks of tetrahedra, written as a mesh file and a scene. Needles enter along +z through the surface "skin". */
#ifndef TROCAR_TESTS_BLOCKS_H
#define TROCAR_TESTS_BLOCKS_H

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "lockstep.h"

/* A box of cells, each made of six tetrahedra. Cells from layer `split` on along z belong to region `below`, the others to `above`. */
typedef struct {
    vec3 low, high;          /* m */
    int cells[3], split;
    int above, below;        /* region indices, counted from 1 */
    bool skin;               /* whether the face at the smallest z belongs to "skin" */
} block;

typedef struct {
    FILE *file;
    char *elements;          /* the element lines of the file */
    FILE *lines;
    size_t size;
    int nodes, element_count;
    double unit;
    unsigned seed;
} block_writer;

/* Returns a random number in [-0.5, 0.5]. The sequence is the same on every machine. */
static inline double blocks_random(block_writer *w) {
    w->seed = w->seed * 1664525u + 1013904223u;
    return w->seed / 4294967296.0 - 0.5;
}

static inline int block_node(const block *b, int first, const int at[3]) {
    return first + at[0] + (b->cells[0] + 1) * (at[1] + (b->cells[1] + 1) * at[2]);
}

/* Writes the nodes. Those inside a region are displaced at random by up to a sixth of a cell. */
static inline void write_block_nodes(block_writer *w, const block *b) {
    int n[3] = {b->cells[0] + 1, b->cells[1] + 1, b->cells[2] + 1};
    vec3 size = v3_sub(b->high, b->low), cell = v3(size.x / b->cells[0], size.y / b->cells[1], size.z / b->cells[2]);
    for (int i = 0; i < n[0] * n[1] * n[2]; i++) {
        int x = i % n[0], y = i / n[0] % n[1], z = i / n[0] / n[1];
        bool inside = x % b->cells[0] && y % b->cells[1] && z % b->cells[2] && z != b->split;
        double by = inside ? 1.0 / 3.0 : 0.0;
        fprintf(w->file, "%d %.17g %.17g %.17g\n", ++w->nodes, (b->low.x + cell.x * (x + by * blocks_random(w))) / w->unit,
                (b->low.y + cell.y * (y + by * blocks_random(w))) / w->unit, (b->low.z + cell.z * (z + by * blocks_random(w))) / w->unit);
    }
}

/* If three of the tetrahedron's nodes have the coordinate `value` along `axis`, writes their triangle as a member of `group`. */
static inline void write_triangle(block_writer *w, const int nodes[4], int at[4][3], int axis, int value, int group) {
    int on[4], count = 0;
    for (int k = 0; k < 4; k++)
        if (at[k][axis] == value) on[count++] = nodes[k];
    if (count == 3) fprintf(w->lines, "%d 2 2 %d %d %d %d %d\n", ++w->element_count, group, group, on[0], on[1], on[2]);
}

static inline void write_block_elements(block_writer *w, const block *b, int first, int skin, int fixed) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    for (int t = 0; t < 6 * b->cells[0] * b->cells[1] * b->cells[2]; t++) {
        int cell = t / 6, now[3] = {cell % b->cells[0], cell / b->cells[0] % b->cells[1], cell / b->cells[0] / b->cells[1]};
        int region = now[2] < b->split ? b->above : b->below, nodes[4], at[4][3];
        for (int k = 0; k < 4; k++) {
            nodes[k] = block_node(b, first, now);
            memcpy(at[k], now, sizeof now);
            if (k < 3) now[orders[t % 6][k]]++;
        }
        fprintf(w->lines, "%d 4 2 %d %d %d %d %d %d\n", ++w->element_count, region, region, nodes[0], nodes[1], nodes[2], nodes[3]);
        if (b->skin) write_triangle(w, nodes, at, 2, 0, skin);
        write_triangle(w, nodes, at, 0, 0, fixed);
        write_triangle(w, nodes, at, 0, b->cells[0], fixed);
    }
}

/* Writes blocks as a mesh in units of `unit` (m) with regions "r1" to "r<regions>". The surface "fixed" consists of the sides normal to x. */
static inline void blocks_write_mesh(const char *path, const block *blocks, int count, int regions, double unit) {
    block_writer w = {.file = fopen(path, "w"), .unit = unit};
    w.lines = open_memstream(&w.elements, &w.size);
    int total = 0, skin = regions + 1, fixed = regions + 2;
    for (int i = 0; i < count; i++) total += (blocks[i].cells[0] + 1) * (blocks[i].cells[1] + 1) * (blocks[i].cells[2] + 1);
    fprintf(w.file, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n%d\n", regions + 2);
    for (int r = 1; r <= regions; r++) fprintf(w.file, "3 %d \"r%d\"\n", r, r);
    fprintf(w.file, "2 %d \"skin\"\n2 %d \"fixed\"\n$EndPhysicalNames\n$Nodes\n%d\n", skin, fixed, total);
    for (int i = 0; i < count; i++) {
        int first = w.nodes + 1;
        write_block_nodes(&w, &blocks[i]);
        write_block_elements(&w, &blocks[i], first, skin, fixed);
    }
    fclose(w.lines);
    fprintf(w.file, "$EndNodes\n$Elements\n%d\n%s$EndElements\n", w.element_count, w.elements);
    free(w.elements);
    fclose(w.file);
}

/* Returns a configuration for such a mesh: 20 kPa in every region, and a skin that is punctured at 0.6 N. */
static inline simulation_config blocks_config(const char *path, int regions) {
    simulation_config c;
    simulation_defaults(&c);
    snprintf(c.mesh_path, sizeof c.mesh_path, "%s", path);
    for (int r = 0; r < regions; r++) {
        region_config *region = &c.regions[c.region_count++];
        snprintf(region->name, sizeof region->name, "r%d", r + 1);
        region->material = region_defaults();
        region->material.youngs_modulus = 20e3;
    }
    c.membranes[c.membrane_count++] = (membrane_config){.name = "skin", .puncture_force = 0.6};
    snprintf(c.fixed[c.fixed_count++], MESH_NAME, "fixed");
    return c;
}

#endif
