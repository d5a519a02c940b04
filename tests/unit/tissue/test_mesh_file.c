/* Tests reading meshes: two hand-written tetrahedra in several formats, the prostate, and invalid files. */
#define _GNU_SOURCE /* memmem */
#include "mesh/mesh.h" /* before cmocka.h, whose macro hides `fail` */

#include <dlfcn.h>
#include <float.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

/* The tetrahedra have nodes 1 2 3 5 and 2 3 5 7. Node 4 is unused, and the second tetrahedron is inverted. */
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

/* Suppresses reports of memory that Gmsh leaks when it stops reading in the middle of a file. Only LeakSanitizer calls this. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:libgmsh\n"; }

static bool gmsh_is_absent; /* simulates a machine without Gmsh */
static int loads;           /* of Gmsh */
void *__real_dlopen(const char *path, int flags);
void *__wrap_dlopen(const char *path, int flags);
void *__wrap_dlopen(const char *path, int flags) {
    loads++;
    return gmsh_is_absent ? NULL : __real_dlopen(path, flags);
}

/* Skips the rest of a test case if Gmsh is not installed, as in the system that scripts/arm64 uses. */
static void need_gmsh(void) {
    if (__real_dlopen("libgmsh.so.4.8", RTLD_LAZY) == NULL) skip();
}

static char directory[] = "/tmp/test_mesh_file.XXXXXX";

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

static trocar_status read_text(const char *name, const char *text, size_t length, mesh *m, trocar_error *why) {
    char path[128];
    snprintf(path, sizeof path, "%s/%s", directory, name);
    write_file(path, text, length);
    trocar_status status = mesh_read(path, m, why);
    unlink(path);
    return status;
}

static void read_good(const char *name, const char *text, mesh *m) {
    trocar_error why = {""};
    if (read_text(name, text, strlen(text), m, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* Checks that the file is refused with a message that contains its name and `words`, and that no memory stays allocated. */
static void assert_refused(const char *name, const char *text, size_t length, const char *words) {
    trocar_error why = {""};
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

static void assert_reads(const char *text, size_t length) {
    mesh m;
    trocar_error why = {""};
    loads = 0;
    if (read_text("two.msh", text, length, &m, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_two_tets(&m);
    assert_names(&m);
    assert_int_equal(loads, 0); /* without Gmsh */
    mesh_free(&m);
}

static void msh_2_and_4_keep_names_and_the_order_of_nodes(void **state) {
    (void)state;
    assert_reads(MSH2, strlen(MSH2));
    assert_reads(MSH4, strlen(MSH4));
}

/* ---- binary files, written here byte by byte ---- */

typedef struct { char bytes[4096]; size_t length; bool swapped; } binary_file;

static void put(binary_file *f, const void *value, size_t size) {
    const char *from = value;
    for (size_t i = 0; i < size; i++) f->bytes[f->length++] = from[f->swapped ? size - 1 - i : i];
}
static void put_int(binary_file *f, int32_t value) { put(f, &value, sizeof value); }
static void put_size(binary_file *f, uint64_t value) { put(f, &value, sizeof value); }
static void put_real(binary_file *f, double value) { put(f, &value, sizeof value); }
static void put_text(binary_file *f, const char *text) { f->length += (size_t)sprintf(f->bytes + f->length, "%s", text); }
static void put_ints(binary_file *f, int count, const int *values) {
    for (int i = 0; i < count; i++) put_int(f, values[i]);
}
static void put_sizes(binary_file *f, int count, const int *values) {
    for (int i = 0; i < count; i++) put_size(f, (uint64_t)values[i]);
}
#define INTS(...) (int)(sizeof(int[]){__VA_ARGS__} / sizeof(int)), (int[]){__VA_ARGS__}

static const struct { int tag; double x[3]; } NODES[6] = {{1, {0, 0, 0}}, {2, {1, 0, 0}}, {3, {0, 1, 0}}, {4, {9, 9, 9}}, {5, {0, 0, 1}}, {7, {1, 1, 1}}};

/* Writes the same mesh as binary MSH2. Each block of elements starts with the type, the number of elements and the number of tags. */
static void write_binary_2(binary_file *f) {
    put_text(f, "$MeshFormat\n2.2 1 8\n");
    put_int(f, 1);
    put_text(f, "\n$EndMeshFormat\n" NAMES "$Nodes\n6\n");
    for (int n = 0; n < 6; n++) {
        put_int(f, NODES[n].tag);
        for (int k = 0; k < 3; k++) put_real(f, NODES[n].x[k]);
    }
    put_text(f, "\n$EndNodes\n$Elements\n5\n");
    put_ints(f, INTS(15, 1, 2, 1, 1, 1, 7));
    put_ints(f, INTS(2, 2, 2, 2, 2, 1, 1, 2, 3, 3, 3, 2, 2, 3, 5));
    put_ints(f, INTS(4, 2, 2, 4, 4, 1, 1, 2, 3, 5, 5, 5, 2, 2, 3, 5, 7));
    put_text(f, "\n$EndElements\n");
}

/* Writes the same mesh as binary MSH4. */
static void write_binary_4(binary_file *f) {
    put_text(f, "$MeshFormat\n4.1 1 8\n");
    put_int(f, 1);
    put_text(f, "\n$EndMeshFormat\n" NAMES "$Entities\n");
    put_sizes(f, INTS(1, 0, 2, 2));
    for (int group = 1; group <= 5; group++) { /* point 1, surfaces 1 and 2, and volumes 1 and 2, each in a group of its own */
        put_int(f, group < 2 ? 1 : 1 + group % 2);
        for (int k = 0; k < (group == 1 ? 3 : 6); k++) put_real(f, k > 2);
        put_size(f, 1);
        put_int(f, group);
        if (group > 1) put_size(f, 0);
    }
    put_text(f, "\n$EndEntities\n$Nodes\n");
    put_sizes(f, INTS(2, 6, 1, 7));
    put_ints(f, INTS(3, 2, 0));
    put_sizes(f, INTS(1, 7));
    for (int k = 0; k < 3; k++) put_real(f, 1);
    put_ints(f, INTS(3, 1, 0));
    put_sizes(f, INTS(5, 1, 2, 3, 4, 5));
    for (int n = 0; n < 5; n++)
        for (int k = 0; k < 3; k++) put_real(f, NODES[n].x[k]);
    put_text(f, "\n$EndNodes\n$Elements\n");
    put_sizes(f, INTS(5, 5, 1, 5));
    static const int blocks[5][3] = {{0, 1, 15}, {2, 1, 2}, {2, 2, 2}, {3, 1, 4}, {3, 2, 4}};
    static const int corners[5][4] = {{7}, {1, 2, 3}, {2, 3, 5}, {1, 2, 3, 5}, {2, 3, 5, 7}};
    for (int b = 0; b < 5; b++) {
        put_ints(f, 3, blocks[b]);
        put_sizes(f, INTS(1, b + 1));
        put_sizes(f, blocks[b][0] + 1, corners[b]);
    }
    put_text(f, "\n$EndElements\n");
}

static void binary_files_are_read_in_both_byte_orders(void **state) {
    (void)state;
    for (int swapped = 0; swapped < 2; swapped++) {
        binary_file two = {.swapped = swapped}, four = {.swapped = swapped};
        write_binary_2(&two);
        write_binary_4(&four);
        assert_reads(two.bytes, two.length);
        assert_reads(four.bytes, four.length);
        for (size_t length = 9; length < two.length - 1; length++) assert_refused("cut2.msh", two.bytes, length, "cut2.msh");
        for (size_t length = 9; length < four.length - 1; length++) assert_refused("cut4.msh", four.bytes, length, "cut4.msh");
        char words[64];
        snprintf(words, sizeof words, "cut2.msh: byte %zu: the file ends inside $Elements", two.length - 60);
        assert_refused("cut2.msh", two.bytes, two.length - 60, words);
    }
}

/* Overwrites the number at `offset` after the text `place` with `value`, and checks that the file is refused. */
static void assert_number_refused(void (*write_file)(binary_file *), const char *place, size_t offset, size_t size, uint64_t value, const char *words) {
    binary_file f = {.swapped = false};
    write_file(&f);
    char *at = memmem(f.bytes, f.length, place, strlen(place));
    assert_non_null(at);
    memcpy(at + strlen(place) + offset, &value, size);
    assert_refused("changed.msh", f.bytes, f.length, words);
}

static void absurd_numbers_in_binary_files_are_refused(void **state) {
    (void)state;
    const uint64_t huge = UINT64_MAX / 2;
    assert_number_refused(write_binary_4, "$Nodes\n", 8, 8, huge, "for which the file is too short");
    assert_number_refused(write_binary_4, "$Nodes\n", 8, 8, UINT64_MAX, "for which the file is too short");
    assert_number_refused(write_binary_4, "$Nodes\n", 8, 8, 5, "more nodes than the 5");
    assert_number_refused(write_binary_4, "$Nodes\n", 44, 8, huge, "more nodes than the 6");
    assert_number_refused(write_binary_4, "$Nodes\n", 0, 8, huge, "changed.msh: byte");
    assert_number_refused(write_binary_4, "$Elements\n", 8, 8, huge, "for which the file is too short");
    assert_number_refused(write_binary_4, "$Elements\n", 44, 8, huge, "more elements than the 5");
    assert_number_refused(write_binary_4, "$Elements\n", 40, 4, 99, "type 99");
    assert_number_refused(write_binary_4, "$Elements\n", 40, 4, (uint32_t)-1, "type -1");
    assert_number_refused(write_binary_4, "$Entities\n", 0, 8, huge, "changed.msh: byte");
    assert_number_refused(write_binary_4, "$Entities\n", 60, 8, huge, "changed.msh: byte");
    assert_number_refused(write_binary_2, "$Elements\n5\n", 4, 4, 1000000, "more elements than the 5");
    assert_number_refused(write_binary_2, "$Elements\n5\n", 4, 4, (uint32_t)-1, "more elements than the 5");
    assert_number_refused(write_binary_2, "$Elements\n5\n", 8, 4, 1000000000, "the file ends inside $Elements");
    assert_number_refused(write_binary_2, "2.2 1 8\n", 0, 4, 2, "the number 1 does not follow");
}

static void vtk_is_one_region_of_tissue(void **state) {
    (void)state;
    mesh m;
    need_gmsh();
    read_good("two.vtk", VTK, &m);
    assert_two_tets(&m);
    assert_int_equal(m.group_count, 1);
    assert_string_equal(m.groups[m.region[0]].name, "tissue");
    assert_int_equal(m.region[0], m.region[1]);
    mesh_free(&m);
}

/* Returns a copy of a text with one part replaced. */
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

static void errors_in_the_text_name_the_line(void **state) {
    (void)state;
    assert_change_refused(MSH2, "2 1 0 0", "2 1 x 0", "changed.msh:15: \"x\" is not a number");
    assert_change_refused(MSH2, "2 1 0 0", "2 1 0,5 0", "changed.msh:15: \"0,5\"");
    assert_change_refused(MSH2, "2 1 0 0", "2.0 1 0 0", "changed.msh:15: \"2.0\" is not a whole number");
    assert_change_refused(MSH2, "2 1 0 0", "3000000000 1 0 0", "changed.msh:15: 3000000000 is too large");
    assert_change_refused(MSH2, "2 1 0 0", "99999999999999999999 1 0 0", "changed.msh:15: \"99999999999999999999\"");
    assert_change_refused(MSH2, "$Nodes\n6", "$Nodes\n7", "changed.msh:20: \"$EndNodes\"");
    assert_change_refused(MSH2, "$Nodes\n6", "$Nodes\n5", "changed.msh:19: $Nodes goes on");
    assert_change_refused(MSH2, "$Nodes\n6", "$Nodes\n-6", "-6 nodes");
    assert_change_refused(MSH2, "$Nodes\n6", "$Nodes\n2000000000", "changed.msh:13: $Nodes announces 2000000000 nodes, for which the file is too short");
    assert_change_refused(MSH2, "$Elements\n5", "$Elements\n2000000000", "announces 2000000000 elements, for which the file is too short");
    assert_change_refused(MSH2, "$Elements\n5", "$Elements\n6", "changed.msh:28: \"$EndElements\"");
    assert_change_refused(MSH2, "5 4 2 5 2 2 3 5 7\n$EndElements\n", "5 4 2 5 2 2 3 5 7", "the file ends inside $Elements");
    assert_change_refused(MSH2, "5 4 2 5 2 2", "5 11 2 5 2 2", "changed.msh:27: contains elements of type \"Tetrahedron 10\": only linear tetrahedra");
    assert_change_refused(MSH2, "5 4 2 5 2 2", "5 140 2 5 2 2", "type 140");
    assert_change_refused(MSH2, "5 4 2 5 2 2", "5 4 1000000000 5 2 2", "changed.msh");
    assert_change_refused(MSH2, "5 4 2 5 2 2 3 5 7", "5 4 2 5 2 2 3 5 6", "node 6, which does not exist");
    assert_change_refused(MSH2, "4 9 9 9", "3 9 9 9", "node 3 occurs twice");
    assert_change_refused(MSH2, "5 4 2 5 2 2 3 5 7", "4 4 2 5 2 2 3 5 7", "two elements have the number 4");
    assert_change_refused(MSH2, "$Nodes\n", "$Nodes\n0\n$EndNodes\n$Nodes\n", "a second section with nodes");
    assert_change_refused(MSH4, "2 6 1 7", "2 9000000000000000000 1 7", "for which the file is too short");
    assert_change_refused(MSH4, "3 2 0 1", "3 2 0 1000000000000", "changed.msh:22: more nodes than the 6");
    assert_change_refused(MSH4, "3 2 0 1", "4 2 0 1", "dimension 4");
    assert_change_refused(MSH4, "2 6 1 7", "1 6 1 7", "fewer nodes than the 6");
    assert_change_refused(MSH4, "5 5 1 5", "4 5 1 5", "fewer elements than the 5");
    assert_change_refused(MSH4, "3 2 4 1", "2 2 4 1", "elements of dimension 3 in an entity of dimension 2");
    assert_change_refused(MSH4, "2 2 2 1", "2 2 16 1", "changed.msh");
}

static void assert_change_read(const char *text, const char *piece, const char *other) {
    char *changed = with(text, piece, other);
    assert_reads(changed, strlen(changed));
    free(changed);
}

/* Reads sections, nodes and repetitions that the format permits and that must not change the mesh. */
static void what_does_not_concern_the_mesh_is_skipped(void **state) {
    (void)state;
    assert_change_read(MSH2, "$MeshFormat", "$Comments\n1 $Nodes\n$End\n$EndComments\n$MeshFormat");
    assert_change_read(MSH2, "$EndElements\n", "$EndElements\n\n$Periodic\n1\n2 2 1\n1\n1 2\n$EndPeriodic\n$NodeData\n1\n\"u\"\n$EndNodeData\n");
    assert_change_read(MSH2, "$EndElements\n", "$EndElements");
    assert_change_read(MSH2, "5 0 0 1\n7 1 1 1", "7 1 1 1\n5 0 0 1\n");
    assert_change_read(MSH2, "$Nodes\n6\n1 0 0 0\n", "$Nodes\n7\n1 0 0 0\n1 0 0 0\n");
    assert_change_read(MSH2, "5 4 2 5 2 2 3 5 7", "5 4 4 5 2 1 1 2 3 5 7"); /* one partition */
    assert_change_read(MSH2, "5\n1 15", "6\n9 4 2 0 -1 2 3 5 7\n1 15");
    assert_change_read(MSH2, "5\n1 15 2 1 1 7\n2 2 2 2 1", "6\n2 2 2 2 1 1 2 3\n1 15 2 1 1 7\n2 2 2 2 1"); /* an element twice */
    assert_change_read(MSH2, "3 2 2 3 2 2 3 5", "3 2 2 -3 2 2 3 5"); /* reversed */
    assert_change_read(MSH2, "2 3 \"capsule\"", "2 3 \"capsule\"\r");
    assert_change_read(MSH2, "1 0 0 0\n2 1 0 0", "1 0 0 0\r\n 2\t1 0 0");
    assert_change_read(MSH4, "$Nodes", "$Periodic\n1\n$EndPeriodic\n$Nodes");
}

static void parametric_nodes_are_read(void **state) {
    (void)state;
    char *two = with(MSH2, "$Nodes\n6\n" POINTS "$EndNodes",
                     "$ParametricNodes\n6\n1 0 0 0 0 1\n2 1 0 0 1 1 0.5\n3 0 1 0 2 1 0.5 0.25\n4 9 9 9 3 1\n5 0 0 1 2 1 0 0\n7 1 1 1 3 1\n$EndParametricNodes");
    assert_reads(two, strlen(two));
    free(two);
    char *four = with(MSH4, "3 1 0 5\n1\n2\n3\n4\n5\n0 0 0\n1 0 0\n0 1 0\n9 9 9\n0 0 1\n", "2 1 1 5\n1\n2\n3\n4\n5\n0 0 0 3 3\n1 0 0 3 3\n0 1 0 3 3\n9 9 9 3 3\n0 0 1 3 3\n");
    assert_reads(four, strlen(four));
    free(four);
}

/* Volume 2 is split into partitions, and its part 3 contains the tetrahedron. Volume 8 contains ghost elements, which belong to another partition. */
static void partitioned_entities_have_the_groups_of_their_parents(void **state) {
    (void)state;
    char *parts = with(MSH4, "$Nodes", "$PartitionedEntities\n2\n1\n8 1\n0 0 0 1\n3 3 2 1 2 0 0 0 1 1 1 1 5 0\n$EndPartitionedEntities\n$Nodes");
    char *moved = with(parts, "3 2 4 1", "3 8 4 1\n6 1 2 3 5\n3 3 4 1"), *counted = with(moved, "5 5 1 5", "6 6 1 6");
    assert_reads(counted, strlen(counted));
    free(parts);
    free(moved);
    free(counted);
}

static void without_entities_all_is_tissue(void **state) {
    (void)state;
    mesh m;
    const char *from = strstr(MSH4, "$Entities"), *to = strstr(MSH4, "$Nodes");
    char section[512];
    snprintf(section, sizeof section, "%.*s", (int)(to - from), from);
    char *text = with(MSH4, section, "");
    read_good("two.msh", text, &m);
    assert_two_tets(&m);
    assert_int_equal(m.group_count, 1);
    assert_string_equal(m.groups[0].name, "tissue");
    mesh_free(&m);
    free(text);
}

/* Version 2.2 lists the element once for each group; in version 4.1, the groups are those of the entity it is in. */
static void elements_are_in_several_groups(void **state) {
    (void)state;
    mesh m;
    char *two = with(MSH2, "$Elements\n5", "$Elements\n6\n6 2 2 2 2 2 3 5"), *four = with(MSH4, "1 1 1 1 3 0", "1 1 1 2 2 3 0");
    for (int i = 0; i < 2; i++) {
        read_good("two.msh", i == 0 ? two : four, &m);
        assert_group(&m, "skin", 2, 4, (int[]){0, 1, 2, 3});
        assert_group(&m, "capsule", 2, 3, (int[]){1, 2, 3});
        mesh_free(&m);
    }
    free(two);
    free(four);
}

static void other_formats_need_gmsh(void **state) {
    (void)state;
    gmsh_is_absent = true;
    assert_refused("two.vtk", VTK, strlen(VTK), "Gmsh, which reads other formats, is not installed: apt install libgmsh4.8");
    char *other = with(MSH4, "4.1 0 8", "4.0 0 8");
    assert_refused("two.msh", other, strlen(other), "apt install libgmsh4.8");
    free(other);
    gmsh_is_absent = false;
    need_gmsh();
    loads = 0;
    mesh m;
    read_good("two.vtk", VTK, &m);
    assert_int_equal(loads, 1);
    mesh_free(&m);
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
    trocar_error why = {""};
    mesh m;
    assert_int_equal(mesh_read("/nowhere/lost.msh", &m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "/nowhere/lost.msh: cannot open"));
    assert_int_equal(mesh_read(directory, &m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, directory));
    char fifo[128];
    snprintf(fifo, sizeof fifo, "%s/fifo.msh", directory);
    assert_int_equal(mkfifo(fifo, 0600), 0);
    assert_int_equal(mesh_read(fifo, &m, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "not a regular file"));
    unlink(fifo);
    assert_refused("empty.msh", "", 0, "empty");
    assert_refused("nonsense.msh", "the quick brown fox", 19, "nonsense.msh");
    assert_refused("nonsense.bin", "\x7f\x00\x01\xff\xfe;;(((", 10, "nonsense.bin");
    assert_refused("plane.msh", MSH2, strstr(MSH2, "$Elements") - MSH2, "plane.msh");
    for (size_t length = 1; length < sizeof MSH2 - 2; length += 7) assert_refused("cut2.msh", MSH2, length, "cut2.msh");
    for (size_t length = 1; length < sizeof MSH4 - 2; length += 7) assert_refused("cut4.msh", MSH4, length, "cut4.msh");
}

/* Reads the box made by meshes/prostate.py. Its flat facets make the gland slightly smaller than the ellipsoid. */
static void the_prostate_has_its_regions_and_surfaces(void **state) {
    (void)state;
    mesh m;
    trocar_error why = {""};
    if (mesh_read(MESHES "/prostate-570.msh", &m, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_in_range(m.node_count, 541, 599);
    int prostate = mesh_find_group(&m, "prostate", 3), capsule = mesh_find_group(&m, "capsule", 2);
    double total = 0, gland = 0, ellipsoid = 4.0 / 3 * acos(-1) * 0.024 * 0.017 * 0.020;
    for (int t = 0; t < m.tet_count; t++) {
        total += mesh_volume(&m, t);
        if (m.region[t] == prostate) gland += mesh_volume(&m, t);
        for (int i = 0; i < 4; i++) { /* the capsule is the boundary between the regions */
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
        cmocka_unit_test(binary_files_are_read_in_both_byte_orders),
        cmocka_unit_test(absurd_numbers_in_binary_files_are_refused),
        cmocka_unit_test(vtk_is_one_region_of_tissue),
        cmocka_unit_test(unnamed_physical_groups_are_named_by_their_tags),
        cmocka_unit_test(errors_in_the_content_are_named),
        cmocka_unit_test(errors_in_the_text_name_the_line),
        cmocka_unit_test(what_does_not_concern_the_mesh_is_skipped),
        cmocka_unit_test(parametric_nodes_are_read),
        cmocka_unit_test(partitioned_entities_have_the_groups_of_their_parents),
        cmocka_unit_test(without_entities_all_is_tissue),
        cmocka_unit_test(elements_are_in_several_groups),
        cmocka_unit_test(other_formats_need_gmsh),
        cmocka_unit_test(more_groups_than_a_bit_mask_holds_are_refused),
        cmocka_unit_test(non_mesh_files_are_refused),
        cmocka_unit_test(the_prostate_has_its_regions_and_surfaces),
    };
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}
