#include "mesh/msh_reader.h"

#include <inttypes.h>
#include <math.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "mesh/msh_stream.h"

typedef struct {
    msh_stream in;
    msh_contents *contents;
    double version;
    size_t element_room, corner_room, membership_room, name_room; /* number of entries allocated for each array */
    bool has_nodes, has_elements; /* true once the section has been read */
    int *ghosts;             /* volumes whose elements belong to other partitions */
    size_t ghost_count, ghost_room;
} reader;

static bool going_on(const reader *r) { return r->in.status == TROCAR_OK; }

static void out_of_memory(reader *r) {
    if (going_on(r)) r->in.status = fail(r->in.why, TROCAR_NO_MEMORY, "%s: no memory for the mesh", r->in.path);
}

/* Returns the array, reallocated if necessary, with room for at least one more item than `count`. */
static void *grown(reader *r, void *array, size_t count, size_t *room, size_t item) {
    if (count < *room || !going_on(r)) return array;
    size_t wanted = *room > 0 ? 2 * *room : 64;
    void *larger = realloc(array, wanted * item);
    if (!larger) out_of_memory(r);
    else *room = wanted;
    return larger ? larger : array;
}
#define GROW(r, array, count, room) ((array) = grown(r, array, count, &(room), sizeof *(array)))

/* ---- element types ---- */

/* Gmsh's element types 1 to 31 (reference manual, "Node ordering"). Later types have a higher order and do not occur in a mesh of linear tetrahedra. */
static const struct { const char *shape; int dimension, nodes; } ELEMENT_TYPES[] = {
    {0}, {"Line", 1, 2}, {"Triangle", 2, 3}, {"Quadrilateral", 2, 4}, {"Tetrahedron", 3, 4}, {"Hexahedron", 3, 8}, {"Prism", 3, 6}, {"Pyramid", 3, 5},
    {"Line", 1, 3}, {"Triangle", 2, 6}, {"Quadrilateral", 2, 9}, {"Tetrahedron", 3, 10}, {"Hexahedron", 3, 27}, {"Prism", 3, 18}, {"Pyramid", 3, 14},
    {"Point", 0, 1}, {"Quadrilateral", 2, 8}, {"Hexahedron", 3, 20}, {"Prism", 3, 15}, {"Pyramid", 3, 13},
    {"Triangle", 2, 9}, {"Triangle", 2, 10}, {"Triangle", 2, 12}, {"Triangle", 2, 15}, {"Triangle", 2, 15}, {"Triangle", 2, 21},
    {"Line", 1, 4}, {"Line", 1, 5}, {"Line", 1, 6}, {"Tetrahedron", 3, 20}, {"Tetrahedron", 3, 35}, {"Tetrahedron", 3, 56},
};

static bool is_known(int type) { return type > 0 && type < (int)(sizeof ELEMENT_TYPES / sizeof *ELEMENT_TYPES); }

int msh_element_nodes(int type) { return is_known(type) ? ELEMENT_TYPES[type].nodes : 0; }

static bool check_type(reader *r, int type) {
    if (!is_known(type)) msh_fail(&r->in, "contains elements of type %d: only linear tetrahedra (4 nodes) are supported", type);
    else if (ELEMENT_TYPES[type].dimension == 3 && type != MSH_TETRAHEDRON)
        msh_fail(&r->in, "contains elements of type \"%s %d\": only linear tetrahedra (4 nodes) are supported: mesh with order 1", ELEMENT_TYPES[type].shape,
                 ELEMENT_TYPES[type].nodes);
    return going_on(r);
}

/* ---- physical groups ---- */

/* For a reversed entity, Gmsh stores the group's tag with a negative sign. */
static void add_membership(reader *r, int dimension, int entity, int tag) {
    msh_contents *c = r->contents;
    msh_membership added = {dimension, entity, tag < 0 && tag > INT_MIN ? -tag : tag};
    if (c->membership_count > 0 && memcmp(&c->memberships[c->membership_count - 1], &added, sizeof added) == 0) return;
    GROW(r, c->memberships, c->membership_count, r->membership_room);
    if (going_on(r)) c->memberships[c->membership_count++] = added;
}

enum { MOST_NAMES = 10000 };

static bool name_is_taken(const msh_contents *c, int dimension, const char *text) {
    for (size_t i = 0; i < c->name_count; i++)
        if (c->names[i].dimension == dimension && strcmp(c->names[i].text, text) == 0) return true;
    return false;
}

/* In version 2.2, if several groups of one dimension have the same name, the first keeps it and the others become unnamed. */
static void read_names(reader *r) {
    msh_contents *c = r->contents;
    int64_t count = msh_text_int_line(&r->in);
    if (count < 0 || count > MOST_NAMES) msh_fail(&r->in, "$PhysicalNames announces %" PRId64 " names: expected 0 to %d", count, MOST_NAMES);
    for (int64_t i = 0; i < count && going_on(r); i++) {
        msh_name name;
        name.dimension = (int)msh_text_int(&r->in);
        name.tag = (int)msh_text_int(&r->in);
        msh_quoted(&r->in, name.text, sizeof name.text);
        if (name.text[0] == '\0' || (r->version < 3 && name_is_taken(c, name.dimension, name.text))) continue;
        GROW(r, c->names, c->name_count, r->name_room);
        if (going_on(r)) c->names[c->name_count++] = name;
    }
    msh_end_section(&r->in);
}

/* ---- nodes ---- */

/* Makes room for `count` nodes, each of which takes at least 4 numbers (text) or `bytes` bytes (binary) in the file. */
static void begin_nodes(reader *r, uint64_t count, int bytes) {
    if (r->has_nodes) msh_fail(&r->in, "a second section with nodes: export the mesh again");
    r->has_nodes = true;
    if (!msh_fits(&r->in, count, 4, bytes, "nodes")) return;
    if (count > INT_MAX / 3) msh_fail(&r->in, "too many nodes (%" PRIu64 "): mesh more coarsely", count);
    if (going_on(r) && !(r->contents->nodes = malloc((count + 1) * sizeof *r->contents->nodes))) out_of_memory(r);
}

static void read_coordinates(reader *r, msh_node *node, int parameters) {
    for (int k = 0; k < 3; k++) {
        node->x[k] = msh_real(&r->in);
        if (going_on(r) && !isfinite(node->x[k])) msh_fail(&r->in, "a node has the coordinate %g: export the mesh again", node->x[k]);
    }
    for (int k = 0; k < parameters; k++) msh_real(&r->in);
}

static void read_nodes_2(reader *r, bool parametric) {
    int64_t count = msh_text_int_line(&r->in);
    if (count < 0) msh_fail(&r->in, "$%s announces %" PRId64 " nodes: export the mesh again", r->in.section, count);
    begin_nodes(r, (uint64_t)count, 28);
    for (int64_t i = 0; i < count && going_on(r); i++) {
        msh_node *node = &r->contents->nodes[r->contents->node_count++];
        node->tag = (uint64_t)(int64_t)msh_int(&r->in);
        read_coordinates(r, node, 0);
        if (!parametric) continue;
        int dimension = msh_int(&r->in);
        msh_int(&r->in); /* skips the entity */
        for (int k = 0; k < dimension && dimension < 3; k++) msh_real(&r->in);
    }
    msh_end_section(&r->in);
}

static void read_nodes_4(reader *r) {
    msh_contents *c = r->contents;
    uint64_t blocks = msh_size(&r->in), count = msh_size(&r->in);
    msh_size(&r->in), msh_size(&r->in); /* skips the smallest and the largest tag */
    begin_nodes(r, count, 32);
    for (uint64_t b = 0; b < blocks && going_on(r); b++) {
        int dimension = msh_int(&r->in);
        msh_int(&r->in); /* skips the entity */
        int parameters = msh_int(&r->in) ? dimension : 0;
        uint64_t added = msh_size(&r->in);
        if (dimension < 0 || dimension > 3) msh_fail(&r->in, "nodes of an entity of dimension %d: export the mesh again", dimension);
        if (going_on(r) && added > count - c->node_count) msh_fail(&r->in, "more nodes than the %" PRIu64 " that $Nodes announces: export the mesh again", count);
        for (uint64_t i = 0; i < added && going_on(r); i++) c->nodes[c->node_count + i].tag = msh_size(&r->in);
        for (uint64_t i = 0; i < added && going_on(r); i++) read_coordinates(r, &c->nodes[c->node_count++], parameters);
    }
    if (going_on(r) && c->node_count < count) msh_fail(&r->in, "fewer nodes than the %" PRIu64 " that $Nodes announces: export the mesh again", count);
    msh_end_section(&r->in);
}

/* ---- elements ---- */

static void begin_elements(reader *r, uint64_t count, int numbers, int bytes) {
    if (r->has_elements) msh_fail(&r->in, "a second section $Elements: export the mesh again");
    r->has_elements = true;
    if (!msh_fits(&r->in, count, numbers, bytes, "elements")) return;
    if (count > INT_MAX / 16) msh_fail(&r->in, "too many elements (%" PRIu64 "): mesh more coarsely", count);
    r->element_room = count + 1;
    if (going_on(r) && !(r->contents->elements = malloc(r->element_room * sizeof *r->contents->elements))) out_of_memory(r);
}

/* Reads an element's nodes and stores the element. There must be room for it. */
static void read_corners(reader *r, msh_element element) {
    msh_contents *c = r->contents;
    element.first = c->corner_count;
    for (int k = 0; k < msh_element_nodes(element.type) && going_on(r); k++) {
        GROW(r, c->corners, c->corner_count, r->corner_room);
        uint64_t node = r->version < 3 ? (uint64_t)(int64_t)msh_int(&r->in) : msh_size(&r->in);
        if (going_on(r)) c->corners[c->corner_count++] = node;
    }
    if (going_on(r)) c->elements[c->element_count++] = element;
}

/* Reads an element with its tags. The first tag is its physical group or 0, the second its entity; the others concern partitions. Like Gmsh, skips elements
   with a negative entity. */
static void read_element_2(reader *r, int64_t number, int type, int tags) {
    int physical = 0, entity = 0;
    for (int i = 0; i < tags && going_on(r); i++) {
        int tag = msh_int(&r->in);
        if (i == 0) physical = tag;
        if (i == 1) entity = tag;
    }
    if (!check_type(r, type)) return;
    msh_element element = {ELEMENT_TYPES[type].dimension, entity, type, (uint64_t)number, 0};
    read_corners(r, element);
    if (entity < 0 && going_on(r)) r->contents->element_count--;
    if (entity >= 0 && physical != 0) add_membership(r, element.dimension, entity, physical);
}

static void read_elements_2(reader *r) {
    int64_t count = msh_text_int_line(&r->in);
    if (count < 0) msh_fail(&r->in, "$Elements announces %" PRId64 " elements: export the mesh again", count);
    begin_elements(r, (uint64_t)count, 4, 8);
    for (int64_t i = 0; i < count && going_on(r);) {
        int number = 0, type, tags, block = 1; /* in a binary file, each block of similar elements has a header */
        if (!r->in.binary) number = msh_int(&r->in);
        type = msh_int(&r->in);
        if (r->in.binary) block = msh_int(&r->in);
        tags = msh_int(&r->in);
        if (block < 0 || block > count - i) msh_fail(&r->in, "more elements than the %" PRId64 " that $Elements announces: export the mesh again", count);
        for (int b = 0; b < block && going_on(r); b++, i++) read_element_2(r, r->in.binary ? msh_int(&r->in) : number, type, tags);
    }
    msh_end_section(&r->in);
}

static bool is_ghost(const reader *r, int entity) {
    for (size_t i = 0; i < r->ghost_count; i++)
        if (r->ghosts[i] == entity) return true;
    return false;
}

static void read_elements_4(reader *r) {
    msh_contents *c = r->contents;
    uint64_t blocks = msh_size(&r->in), count = msh_size(&r->in), read = 0;
    msh_size(&r->in), msh_size(&r->in); /* skips the smallest and the largest tag */
    begin_elements(r, count, 2, 16);
    for (uint64_t b = 0; b < blocks && going_on(r); b++) {
        int dimension = msh_int(&r->in), entity = msh_int(&r->in), type = msh_int(&r->in);
        uint64_t added = msh_size(&r->in);
        if (!check_type(r, type)) return;
        if (dimension != ELEMENT_TYPES[type].dimension)
            msh_fail(&r->in, "elements of dimension %d in an entity of dimension %d: export the mesh again", ELEMENT_TYPES[type].dimension, dimension);
        if (added > count - read) msh_fail(&r->in, "more elements than the %" PRIu64 " that $Elements announces: export the mesh again", count);
        bool ghost = dimension == 3 && is_ghost(r, entity);
        for (uint64_t i = 0; i < added && going_on(r); i++, read++) {
            msh_size(&r->in); /* skips the tag */
            read_corners(r, (msh_element){dimension, entity, type, read, 0});
            if (ghost && going_on(r)) c->element_count--;
        }
    }
    if (going_on(r) && read < count) msh_fail(&r->in, "fewer elements than the %" PRIu64 " that $Elements announces: export the mesh again", count);
    msh_end_section(&r->in);
}

/* ---- entities, version 4.1 ---- */

static void read_entity(reader *r, int dimension, bool partition) {
    int entity = msh_int(&r->in);
    if (partition) {
        msh_int(&r->in), msh_int(&r->in); /* skips dimension and tag of the parent entity */
        for (uint64_t i = msh_size(&r->in); i > 0 && going_on(r); i--) msh_int(&r->in);
    }
    for (int k = 0; k < (dimension == 0 ? 3 : 6); k++) msh_real(&r->in); /* skips the point or the bounding box */
    for (uint64_t i = msh_size(&r->in); i > 0 && going_on(r); i--) add_membership(r, dimension, entity, msh_int(&r->in));
    if (dimension == 0) return;
    for (uint64_t i = msh_size(&r->in); i > 0 && going_on(r); i--) msh_int(&r->in); /* skips the bounding entities */
}

static void read_entities(reader *r, bool partitions) {
    if (partitions) {
        msh_size(&r->in); /* skips the number of partitions */
        for (uint64_t i = msh_size(&r->in); i > 0 && going_on(r); i--) {
            GROW(r, r->ghosts, r->ghost_count, r->ghost_room);
            int ghost = msh_int(&r->in);
            if (going_on(r)) r->ghosts[r->ghost_count++] = ghost;
            msh_int(&r->in); /* skips the partition */
        }
    }
    uint64_t counts[4];
    for (int d = 0; d < 4; d++) counts[d] = msh_size(&r->in);
    for (int d = 0; d < 4; d++)
        for (uint64_t i = 0; i < counts[d] && going_on(r); i++) read_entity(r, d, partitions);
    msh_end_section(&r->in);
}

/* ---- order ---- */

/* Sorts the items. Returns false if they were already sorted. */
static bool sort(void *items, size_t count, size_t size, int (*compare)(const void *, const void *)) {
    const char *at = items;
    size_t i = 1;
    while (i < count && compare(at + (i - 1) * size, at + i * size) < 0) i++;
    if (i < count) qsort(items, count, size, compare);
    return i < count;
}

static int compare_tags(const void *left, const void *right) {
    const msh_node *a = left, *b = right;
    return (a->tag > b->tag) - (a->tag < b->tag);
}

/* Sorts the nodes and removes duplicates. */
static void unite_nodes(reader *r) {
    msh_contents *c = r->contents;
    size_t kept = 0;
    if (!sort(c->nodes, c->node_count, sizeof *c->nodes, compare_tags)) return;
    for (size_t i = 1; i < c->node_count; i++) {
        if (c->nodes[i].tag != c->nodes[kept].tag) c->nodes[++kept] = c->nodes[i];
        else if (memcmp(c->nodes[i].x, c->nodes[kept].x, sizeof c->nodes[i].x) != 0) {
            r->in.status = fail(r->in.why, TROCAR_BAD_INPUT, "%s: node %" PRId64 " occurs twice, at different places: export the mesh again", r->in.path,
                                (int64_t)c->nodes[i].tag);
            return;
        }
    }
    c->node_count = kept + 1;
}

static int compare_numbers(const void *left, const void *right) {
    const msh_element *a = left, *b = right;
    return a->number != b->number ? (a->number > b->number) - (a->number < b->number) : (a->first > b->first) - (a->first < b->first);
}

static int compare_elements(const void *left, const void *right) {
    const msh_element *a = left, *b = right;
    if (a->dimension != b->dimension) return a->dimension < b->dimension ? -1 : 1;
    if (a->entity != b->entity) return a->entity < b->entity ? -1 : 1;
    return (a->number > b->number) - (a->number < b->number);
}

/* Removes duplicates: an element in several physical groups may occur once per group, always with the same number. */
static void unite_elements(reader *r) {
    msh_contents *c = r->contents;
    size_t kept = 0;
    sort(c->elements, c->element_count, sizeof *c->elements, compare_numbers);
    for (size_t i = 1; i < c->element_count; i++) {
        const msh_element *a = &c->elements[kept], *b = &c->elements[i];
        if (a->number != b->number) c->elements[++kept] = *b;
        else if (a->entity != b->entity || a->type != b->type ||
                 memcmp(&c->corners[a->first], &c->corners[b->first], (size_t)msh_element_nodes(a->type) * sizeof *c->corners) != 0) {
            r->in.status = fail(r->in.why, TROCAR_BAD_INPUT, "%s: two elements have the number %" PRId64 ": renumber them, or export the mesh again",
                                r->in.path, (int64_t)a->number);
            return;
        }
    }
    if (c->element_count > 0) c->element_count = kept + 1;
    sort(c->elements, c->element_count, sizeof *c->elements, compare_elements);
}

static int compare_memberships(const void *left, const void *right) {
    const msh_membership *a = left, *b = right;
    if (a->dimension != b->dimension) return a->dimension < b->dimension ? -1 : 1;
    if (a->entity != b->entity) return a->entity < b->entity ? -1 : 1;
    return (a->tag > b->tag) - (a->tag < b->tag);
}

static void sort_memberships(msh_contents *c) {
    size_t kept = 0;
    if (c->membership_count == 0) return;
    qsort(c->memberships, c->membership_count, sizeof *c->memberships, compare_memberships);
    for (size_t i = 1; i < c->membership_count; i++)
        if (compare_memberships(&c->memberships[i], &c->memberships[kept]) != 0) c->memberships[++kept] = c->memberships[i];
    c->membership_count = kept + 1;
}

/* ---- the whole file ---- */

/* Reads $MeshFormat up to and including its three numbers: the version, the file type (0: text, 1: binary) and the size of a size_t in bytes. Earlier
   sections are taken as comments and skipped. */
static bool read_format(reader *r, int64_t *binary, int64_t *size) {
    do {
        if (!msh_next_section(&r->in)) return false;
        if (strcmp(r->in.section, "MeshFormat") != 0) msh_skip_section(&r->in);
    } while (strcmp(r->in.section, "MeshFormat") != 0 && going_on(r));
    r->version = msh_text_real(&r->in);
    *binary = msh_text_int(&r->in);
    *size = msh_text_int_line(&r->in);
    return going_on(r);
}

static void read_sections(reader *r) {
    while (msh_next_section(&r->in)) {
        const char *name = r->in.section;
        bool old = r->version < 3;
        if (strcmp(name, "PhysicalNames") == 0) read_names(r);
        else if (strcmp(name, "Nodes") == 0 && old) read_nodes_2(r, false);
        else if (strcmp(name, "ParametricNodes") == 0 && old) read_nodes_2(r, true);
        else if (strcmp(name, "Elements") == 0 && old) read_elements_2(r);
        else if (strcmp(name, "Entities") == 0 && !old) read_entities(r, false);
        else if (strcmp(name, "PartitionedEntities") == 0 && !old) read_entities(r, true);
        else if (strcmp(name, "Nodes") == 0) read_nodes_4(r);
        else if (strcmp(name, "Elements") == 0) read_elements_4(r);
        else msh_skip_section(&r->in);
    }
}

bool msh_is_readable(FILE *file) {
    char first[10] = "";
    trocar_error why;
    int64_t binary, size;
    reader r = {.in = {.file = file, .path = "", .why = &why, .line = 1}};
    rewind(file);
    if (fread(first, 1, sizeof first - 1, file) < sizeof first - 1) return false;
    if (strncmp(first, "$MeshForm", 9) != 0 && strncmp(first, "$Comments", 9) != 0) return false;
    rewind(file);
    return !read_format(&r, &binary, &size) || r.version == 2.2 || r.version == 4.1; /* also true for a damaged header, so that msh_read reports it */
}

trocar_status msh_read(FILE *file, const char *path, bool converted, msh_contents *contents, trocar_error *why) {
    memset(contents, 0, sizeof *contents);
    reader r = {.in = {.file = file, .path = path, .converted = converted, .why = why, .line = 1}, .contents = contents};
    struct stat status;
    int64_t binary, size;
    rewind(file);
    if (fstat(fileno(file), &status) == 0) r.in.size = (uint64_t)status.st_size;
    if (!read_format(&r, &binary, &size)) return going_on(&r) ? msh_fail(&r.in, "no section $MeshFormat: export the mesh again") : r.in.status;
    if (binary && r.version > 3 && size != 8)
        msh_fail(&r.in, "binary with sizes of %" PRId64 " bytes instead of 8: export the mesh again, as text", size);
    if (binary) msh_byte_order(&r.in);
    msh_end_section(&r.in);
    read_sections(&r);
    if (going_on(&r)) unite_nodes(&r);
    if (going_on(&r)) unite_elements(&r);
    if (going_on(&r)) sort_memberships(contents);
    free(r.ghosts);
    return r.in.status;
}

void msh_free(msh_contents *c) {
    free(c->nodes);
    free(c->elements);
    free(c->corners);
    free(c->memberships);
    free(c->names);
    memset(c, 0, sizeof *c);
}
