/* Tests that patches of tetrahedra are disjoint, that each lies in one region, is connected through faces and has the documented size, and that the
   partition is reproducible. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "tissue/strain_patches.h"

#include <cmocka.h>

enum { WANTED = 8, LEAST = 4, MOST = 12 };

static int *create(const mesh *m, int *count) {
    int *patch = malloc((size_t)m->tet_count * sizeof *patch);
    trocar_error why = {""};
    if (strain_patches_create(m, patch, count, &why) != TROCAR_OK) fail_msg("%s", why.text);
    return patch;
}

static bool joined(const mesh *m, int tet, int face) {
    int other = m->neighbours[tet][face];
    return other >= 0 && m->region[other] == m->region[tet];
}

/* Returns the number of tetrahedra that can be reached from `tet` through faces without leaving its region or, unless `patch` is NULL, its patch. */
static int reached_from(const mesh *m, int tet, const int *patch) {
    int *found = malloc((size_t)m->tet_count * sizeof *found), count = 1;
    bool *seen = calloc((size_t)m->tet_count, sizeof *seen);
    found[0] = tet;
    seen[tet] = true;
    for (int i = 0; i < count; i++)
        for (int face = 0; face < 4; face++) {
            int other = m->neighbours[found[i]][face];
            if (!joined(m, found[i], face) || seen[other] || (patch && patch[other] != patch[tet])) continue;
            seen[other] = true;
            found[count++] = other;
        }
    free(found);
    free(seen);
    return count;
}

/* Checks that every tetrahedron belongs to one patch, and that each patch is connected and lies in one region. A patch of fewer than LEAST tetrahedra must
   be a whole connected component of its region. */
static void check_partition(const mesh *m, int most) {
    int count, usual = 0, *patch = create(m, &count), *size = calloc((size_t)count, sizeof *size), *first = malloc((size_t)count * sizeof *first);
    for (int e = m->tet_count - 1; e >= 0; e--) {
        assert_in_range(patch[e], 0, count - 1);
        size[patch[e]]++;
        first[patch[e]] = e;
    }
    for (int e = 0; e < m->tet_count; e++) assert_int_equal(m->region[e], m->region[first[patch[e]]]);
    for (int p = 0; p < count; p++) {
        assert_in_range(size[p], 1, most);
        assert_int_equal(reached_from(m, first[p], patch), size[p]);
        if (size[p] < LEAST) assert_int_equal(reached_from(m, first[p], NULL), size[p]);
        usual += size[p] == WANTED;
    }
    if (m->tet_count > 100 * WANTED) assert_true(usual > 0.9 * count);
    free(patch);
    free(size);
    free(first);
}

static void meshes_are_divided_into_patches(void **state) {
    (void)state;
    static const char *const paths[] = {MESHES "/prostate-570.msh", MESHES "/prostate.msh"};
    mesh m;
    cube c;
    trocar_error why;
    for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
        assert_int_equal(mesh_read(paths[i], &m, &why), TROCAR_OK);
        check_partition(&m, MOST);
        mesh_free(&m);
    }
    assert_int_equal(cube_shape(&c, 0.1, &why), TROCAR_OK); /* a structured mesh of Kuhn's tetrahedra */
    check_partition(&c.mesh, MOST);
    cube_free(&c);
}

/* Regions assigned at random have connected components of all sizes, down to single tetrahedra. A patch that absorbs many remainders may be large. */
static void scattered_regions_are_divided(void **state) {
    (void)state;
    trocar_error why;
    for (int share = 1; share < 10; share++) {
        cube c;
        assert_int_equal(cube_shape(&c, 0.1, &why), TROCAR_OK);
        for (int e = 0; e < c.mesh.tet_count; e++) c.mesh.region[e] = rand() % 10 < share;
        check_partition(&c.mesh, c.mesh.tet_count);
        cube_free(&c);
    }
}

static void single_elements_are_patches(void **state) {
    (void)state;
    trocar_error why;
    cube c;
    assert_int_equal(cube_shape(&c, 0.1, &why), TROCAR_OK);
    int tets = c.mesh.tet_count, count;
    for (int few = 1; few <= 3; few++) {
        for (int e = 0; e < tets; e++) c.mesh.region[e] = e < few ? 0 : 1;
        int *patch = create(&c.mesh, &count);
        for (int e = few; e < tets; e++) assert_int_not_equal(patch[e], patch[0]);
        free(patch);
    }
    cube_free(&c);
}

/* Returns the FNV-1a hash of the patch numbers in element order. */
static uint64_t hash_of(const int *patch, int count) {
    uint64_t hash = 14695981039346656037u;
    for (int i = 0; i < count; i++) hash = (hash ^ (uint64_t)patch[i]) * 1099511628211u;
    return hash;
}

/* Patches depend only on the order of the elements, and do not change when the mesh is translated, rotated or scaled. The expected hash was computed on one
   machine and must be the same on every other. */
static void patches_do_not_depend_on_run_machine_or_rounding(void **state) {
    (void)state;
    mesh m;
    trocar_error why;
    int count, again_count;
    assert_int_equal(mesh_read(MESHES "/prostate-570.msh", &m, &why), TROCAR_OK);
    int *patch = create(&m, &count);
    for (int i = 0; i < m.node_count; i++) m.nodes[i] = v3(1.0 + 3.3 * m.nodes[i].y, 3.3 * m.nodes[i].z, 3.3 * m.nodes[i].x);
    int *again = create(&m, &again_count);
    assert_int_equal(count, again_count);
    assert_memory_equal(patch, again, (size_t)m.tet_count * sizeof *patch);
    assert_int_equal(hash_of(patch, m.tet_count), 0x5dbb51ed96d02833u);
    free(patch);
    free(again);
    mesh_free(&m);
}

/* In a mirrored mesh, each element's corners are in a different order. */
static void mirror_image_has_the_same_patches(void **state) {
    (void)state;
    cube c, image;
    trocar_error why;
    int count, image_count;
    assert_int_equal(cube_shape(&c, 0.1, &why), TROCAR_OK);
    memset(&image, 0, sizeof image);
    image.mesh.group_count = 2;
    memcpy(image.mesh.groups, c.mesh.groups, sizeof c.mesh.groups);
    cube_nodes(&image.mesh, 0.1);
    cube_tets(&image.mesh);
    for (int i = 0; i < c.mesh.node_count; i++) image.mesh.nodes[i] = v3(-c.mesh.nodes[i].x, c.mesh.nodes[i].y, c.mesh.nodes[i].z);
    assert_int_equal(mesh_finish(&image.mesh, 0, NULL, NULL, "image", &why), TROCAR_OK);
    assert_memory_not_equal(image.mesh.tets, c.mesh.tets, (size_t)c.mesh.tet_count * sizeof *c.mesh.tets);
    int *patch = create(&c.mesh, &count), *image_patch = create(&image.mesh, &image_count);
    assert_int_equal(count, image_count);
    assert_memory_equal(patch, image_patch, (size_t)c.mesh.tet_count * sizeof *patch);
    free(patch);
    free(image_patch);
    cube_free(&c);
    cube_free(&image);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(meshes_are_divided_into_patches),
        cmocka_unit_test(scattered_regions_are_divided),
        cmocka_unit_test(single_elements_are_patches),
        cmocka_unit_test(patches_do_not_depend_on_run_machine_or_rounding),
        cmocka_unit_test(mirror_image_has_the_same_patches),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
