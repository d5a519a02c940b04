/* Reading meshes: two tetrahedra written by hand in several formats, the prostate, and invalid files. */
#include "mesh/mesh.h" /* before cmocka.h, whose macro hides `fail` */

#include <float.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

/* Nodes 1 2 3 5 and 2 3 5 7; no tetrahedron uses node 4, and the second tetrahedron is inverted. */
#define NAMES "$PhysicalNames\n5\n0 1 \"anchor\"\n2 2 \"skin\"\n2 3 \"capsule\"\n3 4 \"gland\"\n3 5 \"around\"\n$EndPhysicalNames\n"
#define POINTS "1 0 0 0\n2 1 0 0\n3 0 1 0\n4 9 9 9\n5 0 0 1\n7 1 1 1\n"

static const char MSH2[] =
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" NAMES "$Nodes\n6\n" POINTS "$EndNodes\n$Elements\n5\n"
    "1 15 2 1 1 7\n2 2 2 2 1 1 2 3\n3 2 2 3 2 2 3 5\n4 4 2 4 1 1 2 3 5\n5 4 2 5 2 2 3 5 7\n$EndElements\n";

static const char MSH4[] =
    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n" NAMES
    "$Entities\n1 0 2 2\n1 1 1 1 1 1\n1 0 0 0 1 1 0 1 2 0\n2 0 0 0 1 1 1 1 3 0\n1 0 0 0 1 1 1 1 4 0\n2 0 0 0 1 1 1 1 5 0\n$EndEntities\n"
    "$Nodes\n2 6 1 7\n3 2 0 1\n7\n1 1 1\n3 1 0 5\n1\n2\n3\n4\n5\n0 0 0\n1 0 0\n0 1 0\n9 9 9\n0 0 1\n$EndNodes\n"
    "$Elements\n5 5 1 5\n0 1 15 1\n1 7\n2 1 2 1\n2 1 2 3\n2 2 2 1\n3 2 3 5\n3 1 4 1\n4 1 2 3 5\n3 2 4 1\n5 2 3 5 7\n$EndElements\n";

static const char VTK[] =
    "# vtk DataFile Version 2.0\ntwo tets\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\nCELLS 2 10\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 2\n10\n10\n";

/* Gmsh leaks when it gives up in the middle of a file. Called by LeakSanitizer only. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:libgmsh\n"; }

static char directory[] = "/tmp/test_mesh_gmsh.XXXXXX";

static int make_directory(void **state) {
    (void)state;
    return mkdtemp(directory) ? 0 : -1;
}

static int remove_directory(void **state) {
    (void)state;
    return rmdir(directory);
}

static void write_file(const char *path, const char *text, size_t length) {
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(text, 1, length, file), length);
    fclose(file);
}

static trocar_status read_text(const char *name, const char *text, size_t length, mesh *m, report *why) {
    char path[128];
    snprintf(path, sizeof path, "%s/%s", directory, name);
    write_file(path, text, length);
    trocar_status status = mesh_read(path, m, why);
    unlink(path);
    return status;
}

static void read_good(const char *name, const char *text, mesh *m) {
    report why = {""};
    if (read_text(name, text, strlen(text), m, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* Refused with a message that contains the file's name and `words`; nothing is left allocated. */
static void assert_refused(const char *name, const char *text, size_t length, const char *words) {
    report why = {""};
    mesh m;
    trocar_status status = read_text(name, text, length, &m, &why);
    if (status != TROCAR_BAD_INPUT) fail_msg("%s (%zu bytes): status %d where \"%s\" was expected", name, length, status, words);
    if (!strstr(why.text, name) || !strstr(why.text, words)) fail_msg("\"%s\" lacks %s or \"%s\"", why.text, name, words);
    assert_null(m.nodes);
    assert_int_equal(m.group_count, 0);
}

static void assert_group(const mesh *m, const char *name, int dimension, int count, const int *nodes) {
    int g = mesh_find_group(m, name, dimension);
    assert_true(g >= 0);
    assert_int_equal(m->groups[g].node_count, count);
    assert_memory_equal(m->groups[g].nodes, nodes, count * sizeof *nodes);
}

static void assert_two_tets(const mesh *m) {
    assert_int_equal(m->node_count, 5);
    assert_int_equal(m->tet_count, 2);
    static const double expected[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
    for (int n = 0; n < 5; n++) assert_true(v3_norm(v3_sub(m->nodes[n], v3(expected[n][0], expected[n][1], expected[n][2]))) == 0);
    assert_true(fabs(mesh_volume(m, 0) - 1.0 / 6) < 1e-15);
    assert_true(fabs(mesh_volume(m, 1) - 2.0 / 6) < 1e-15);
    assert_int_equal(m->boundary_count, 6);
}

static void assert_names(const mesh *m) {
    assert_group(m, "anchor", 0, 1, (int[]){4});
    assert_group(m, "skin", 2, 3, (int[]){0, 1, 2});
    assert_group(m, "capsule", 2, 3, (int[]){1, 2, 3});
    assert_group(m, "gland", 3, 4, (int[]){0, 1, 2, 3});
    assert_group(m, "around", 3, 4, (int[]){1, 2, 3, 4});
    int gland = m->region[0] == mesh_find_group(m, "gland", 3) ? 0 : 1;
    assert_int_equal(m->region[gland], mesh_find_group(m, "gland", 3));
    assert_int_equal(m->region[!gland], mesh_find_group(m, "around", 3));
    uint32_t skin = 1u << mesh_find_group(m, "skin", 2), capsule = 1u << mesh_find_group(m, "capsule", 2);
    for (int t = 0; t < 2; t++)
        for (int i = 0; i < 4; i++) {
            bool inner = m->neighbours[t][i] >= 0, below = m->tets[t][i] == 3 && !inner && t == gland;
            assert_int_equal(m->face_groups[t][i], inner ? capsule : below ? skin : 0);
        }
}

static void msh_2_and_4_keep_names_and_the_order_of_nodes(void **state) {
    (void)state;
    mesh m;
    read_good("two.msh", MSH2, &m);
    assert_two_tets(&m);
    assert_names(&m);
    mesh_free(&m);
    read_good("two.msh", MSH4, &m);
    assert_two_tets(&m);
    assert_names(&m);
    mesh_free(&m);
}

static void vtk_is_one_region_of_tissue(void **state) {
    (void)state;
    mesh m;
    read_good("two.vtk", VTK, &m);
    assert_two_tets(&m);
    assert_int_equal(m.group_count, 1);
    assert_string_equal(m.groups[m.region[0]].name, "tissue");
    assert_int_equal(m.region[0], m.region[1]);
    mesh_free(&m);
}

/* Copy of a text with one piece replaced. */
static char *with(const char *text, const char *piece, const char *other) {
    const char *at = strstr(text, piece);
    assert_non_null(at);
    char *changed = malloc(strlen(text) + strlen(other) + 1);
    sprintf(changed, "%.*s%s%s", (int)(at - text), text, other, at + strlen(piece));
    return changed;
}

static void assert_change_refused(const char *text, const char *piece, const char *other, const char *words) {
    char *changed = with(text, piece, other);
    assert_refused("changed.msh", changed, strlen(changed), words);
    free(changed);
}

static void unnamed_physical_groups_are_named_by_their_tags(void **state) {
    (void)state;
    mesh m;
    char *unnamed = with(MSH2, NAMES, "");
    read_good("two.msh", unnamed, &m);
    assert_group(&m, "point_1", 0, 1, (int[]){4});
    assert_group(&m, "surface_3", 2, 3, (int[]){1, 2, 3});
    assert_group(&m, "volume_4", 3, 4, (int[]){0, 1, 2, 3});
    mesh_free(&m);
    free(unnamed);
}

static void errors_in_the_content_are_named(void **state) {
    (void)state;
    assert_change_refused(MSH2, "3 2 2 3 2 2 3 5", "3 2 2 3 2 1 2 7", "\"capsule\"");
    assert_change_refused(MSH2, "3 2 2 3 2 2 3 5", "3 2 2 3 2 2 3 4", "\"capsule\"");
    assert_change_refused(MSH2, "4 1 1 2 3 5", "4 1 1 2 3 2", "no volume");
    assert_change_refused(MSH2, "\"gland\"\n3 5", "\"volume_5\"\n3 6", "two physical volumes");
    assert_change_refused(MSH2, "5 4 2 5 2 2 3 5 7", "5 4 2 0 2 2 3 5 7", "not in a physical volume");
    assert_change_refused(MSH4, "2 0 0 0 1 1 1 1 5 0", "2 0 0 0 1 1 1 2 4 5 0", "leave it in one");
    assert_change_refused(MSH2, "5 4 2 5 2 2 3 5 7", "5 7 2 5 2 1 2 3 5 7", "only linear tetrahedra");
    assert_change_refused(MSH2, "7 1 1 1", "7 1 1 nan", "changed.msh");
    assert_change_refused(MSH2, "5\n1 15 2 1 1 7\n", "5\n1 15 2 1 1 4\n", "\"anchor\"");
    assert_change_refused(MSH2, "\"gland\"", "\"a-name-that-is-longer-than-what-a-scene-file-or-a-mesh-group-can-hold\"", "shorten");
}

static void more_groups_than_a_bit_mask_holds_are_refused(void **state) {
    (void)state;
    char text[8192];
    int used = sprintf(text, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n6\n" POINTS "$EndNodes\n$Elements\n42\n");
    for (int i = 1; i <= 40; i++) used += sprintf(text + used, "%d 15 2 %d %d 7\n", i, i, i);
    used += sprintf(text + used, "41 4 2 4 1 1 2 3 5\n42 4 2 5 2 2 3 5 7\n$EndElements\n");
    assert_refused("many.msh", text, (size_t)used, "more than 32");
}

static void non_mesh_files_are_refused(void **state) {
    (void)state;
    report why = {""};
    mesh m;
    assert_int_equal(mesh_read("/nowhere/lost.msh", &m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "/nowhere/lost.msh: cannot open"));
    assert_int_equal(mesh_read(directory, &m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, directory));
    assert_refused("empty.msh", "", 0, "empty");
    assert_refused("nonsense.msh", "the quick brown fox", 19, "nonsense.msh");
    assert_refused("nonsense.bin", "\x7f\x00\x01\xff\xfe;;(((", 10, "nonsense.bin");
    assert_refused("plane.msh", MSH2, strstr(MSH2, "$Elements") - MSH2, "plane.msh");
    for (size_t length = 1; length < sizeof MSH2 - 14; length += 7) assert_refused("cut2.msh", MSH2, length, "cut2.msh");
    for (size_t length = 1; length < sizeof MSH4 - 14; length += 7) assert_refused("cut4.msh", MSH4, length, "cut4.msh");
}

/* The box of meshes/prostate.py. Flat facets make the ellipsoid's volume a little smaller. */
static void the_prostate_has_its_regions_and_surfaces(void **state) {
    (void)state;
    mesh m;
    report why = {""};
    if (mesh_read(MESHES "/prostate-570.msh", &m, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_in_range(m.node_count, 541, 599);
    int prostate = mesh_find_group(&m, "prostate", 3), capsule = mesh_find_group(&m, "capsule", 2);
    double total = 0, gland = 0, ellipsoid = 4.0 / 3 * acos(-1) * 0.024 * 0.017 * 0.020;
    for (int t = 0; t < m.tet_count; t++) {
        total += mesh_volume(&m, t);
        if (m.region[t] == prostate) gland += mesh_volume(&m, t);
        for (int i = 0; i < 4; i++) { /* the capsule is exactly where the regions meet */
            int other = m.neighbours[t][i];
            assert_int_equal(other >= 0 && m.region[other] != m.region[t], m.face_groups[t][i] >> capsule & 1);
        }
    }
    assert_true(fabs(total - 0.1 * 0.09 * 0.1) < 1e-12);
    assert_true(gland < ellipsoid && gland > 0.8 * ellipsoid);

    const mesh_group *skin = &m.groups[mesh_find_group(&m, "skin", 2)], *fixed = &m.groups[mesh_find_group(&m, "fixed", 2)];
    for (int i = 0; i < skin->node_count; i++) assert_true(fabs(m.nodes[skin->nodes[i]].z) < 1e-9);
    for (int i = 0; i < fixed->node_count; i++) {
        vec3 x = m.nodes[fixed->nodes[i]];
        assert_true(fabs(x.z - 0.1) < 1e-9 || fabs(x.y + 0.045) < 1e-9);
    }
    mesh_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(msh_2_and_4_keep_names_and_the_order_of_nodes),
        cmocka_unit_test(vtk_is_one_region_of_tissue),
        cmocka_unit_test(unnamed_physical_groups_are_named_by_their_tags),
        cmocka_unit_test(errors_in_the_content_are_named),
        cmocka_unit_test(more_groups_than_a_bit_mask_holds_are_refused),
        cmocka_unit_test(non_mesh_files_are_refused),
        cmocka_unit_test(the_prostate_has_its_regions_and_surfaces),
    };
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}
