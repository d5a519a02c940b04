#include "tissue/strain_patches.h"

#include <stdlib.h>

/* Measured for 4 to 12 tetrahedra: smaller patches lock more; larger ones couple more nodes for no benefit. */
enum { PATCH_SIZE = 8, LEAST_SIZE = 4, NO_PATCH = -1 };

typedef struct {
    const mesh *mesh;
    int *patch;              /* [tet_count]: patch of each tetrahedron; initially NO_PATCH */
    int *grown;              /* [tet_count]: tetrahedra, in the order in which they were added to patches */
    int *first;              /* for each patch: index in `grown` of its first tetrahedron */
    int *size;               /* for each patch: number of its tetrahedra */
    int count, taken;        /* number of patches, and of tetrahedra in `grown` */
} partition;

/* Lists the tetrahedra of the same region that share a face with this one, in ascending order, and returns how many there are. Because of this order, ties do
   not depend on how a tetrahedron's corners are ordered, which differs in a mirrored mesh. */
static int beside(const mesh *m, int tet, int others[4]) {
    int count = 0;
    for (int face = 0; face < 4; face++) {
        int other = m->neighbours[tet][face], place = count;
        if (other < 0 || m->region[other] != m->region[tet]) continue;
        for (; place > 0 && others[place - 1] > other; place--) others[place] = others[place - 1];
        others[place] = other;
        count++;
    }
    return count;
}

/* Returns how many faces a tetrahedron shares with tetrahedra of this patch. */
static int shared_faces(const partition *p, int tet, int patch) {
    int others[4], count = beside(p->mesh, tet, others), shared = 0;
    for (int i = 0; i < count; i++) shared += p->patch[others[i]] == patch;
    return shared;
}

static void take(partition *p, int tet) {
    p->patch[tet] = p->count;
    p->grown[p->taken++] = tet;
    p->size[p->count]++;
}

/* ---- growing ------------------------------------------------------------------------------------------------------ */

/* True if all nodes of a tetrahedron are already in the growing patch. */
static bool adds_no_node(const partition *p, int tet) {
    for (int corner = 0; corner < 4; corner++) {
        bool found = false;
        for (int k = p->first[p->count]; k < p->taken && !found; k++)
            for (int c = 0; c < 4; c++) found |= p->mesh->tets[p->grown[k]][c] == p->mesh->tets[tet][corner];
        if (!found) return false;
    }
    return true;
}

/* Rates a free tetrahedron as the next member of the growing patch. A patch with fewer nodes gives K fewer entries. So tetrahedra that add no node come first,
   then those that share more faces with the patch, then those that would otherwise be isolated. */
static int suitability(const partition *p, int tet) {
    return 100 * adds_no_node(p, tet) + 10 * shared_faces(p, tet, p->count) - shared_faces(p, tet, NO_PATCH);
}

/* Returns the free tetrahedron next to the patch that has the best score, or -1 if there is none. The first one wins a tie. */
static int next_member(const partition *p) {
    int best = -1, most = 0, others[4];
    for (int k = p->first[p->count]; k < p->taken; k++) {
        int count = beside(p->mesh, p->grown[k], others);
        for (int i = 0; i < count; i++) {
            if (p->patch[others[i]] != NO_PATCH) continue;
            int suits = suitability(p, others[i]);
            if (best >= 0 && suits <= most) continue;
            best = others[i];
            most = suits;
        }
    }
    return best;
}

static void grow_patch(partition *p, int seed) {
    p->first[p->count] = p->taken;
    p->size[p->count] = 0;
    for (int tet = seed; tet >= 0; tet = p->size[p->count] < PATCH_SIZE ? next_member(p) : -1) take(p, tet);
    p->count++;
}

/* Grows all patches as an advancing front: each starts next to the earliest tetrahedron that still has a free neighbour. */
static void grow_all(partition *p) {
    int front = 0, others[4];
    for (int start = 0; start < p->mesh->tet_count; start++) {
        if (p->patch[start] == NO_PATCH) grow_patch(p, start);
        for (; front < p->taken; front++) {
            int count = beside(p->mesh, p->grown[front], others);
            for (int i = 0; i < count; i++)
                if (p->patch[others[i]] == NO_PATCH) grow_patch(p, others[i]);
        }
    }
}

/* ---- what is left over ---------------------------------------------------------------------------------------------- */

/* Returns the index in `grown` one past a patch's last tetrahedron. */
static int end_of(const partition *p, int patch) { return patch + 1 < p->count ? p->first[patch + 1] : p->taken; }

/* Moves one tetrahedron of a small patch to the smallest adjacent patch that is large enough. Returns false if there is none. */
static bool give_away(partition *p, int small) {
    int given = -1, to = -1, others[4];
    for (int k = p->first[small]; k < end_of(p, small); k++) {
        int tet = p->grown[k], count = p->patch[tet] == small ? beside(p->mesh, tet, others) : 0;
        for (int i = 0; i < count; i++) {
            int patch = p->patch[others[i]];
            if (p->size[patch] < LEAST_SIZE || (to >= 0 && p->size[patch] >= p->size[to])) continue;
            given = tet;
            to = patch;
        }
    }
    if (to < 0) return false;
    p->patch[given] = to;
    p->size[to]++;
    p->size[small]--;
    return true;
}

/* Gives the tetrahedra of patches that could not grow to adjacent patches. The first patch of each connected component is either full or the whole
   component, so in the end only small components have small patches. */
static void dissolve_small(partition *p) {
    for (bool changed = true; changed;) {
        changed = false;
        for (int i = 0; i < p->count; i++)
            while (p->size[i] > 0 && p->size[i] < LEAST_SIZE && give_away(p, i)) changed = true;
    }
}

/* Removes dissolved patches and renumbers the others. */
static void renumber(partition *p) {
    int kept = 0, *number = p->first;
    for (int i = 0; i < p->count; i++) number[i] = p->size[i] > 0 ? kept++ : NO_PATCH;
    for (int tet = 0; tet < p->mesh->tet_count; tet++) p->patch[tet] = number[p->patch[tet]];
    p->count = kept;
}

trocar_status strain_patches_create(const mesh *m, int *patch, int *patch_count, trocar_error *why) {
    size_t tets = (size_t)m->tet_count;
    partition p = {.mesh = m, .patch = patch, .grown = malloc(tets * sizeof(int)), .first = malloc(tets * sizeof(int)),
                   .size = malloc(tets * sizeof(int))};
    trocar_status status = TROCAR_OK;
    if (p.grown && p.first && p.size) {
        for (int tet = 0; tet < m->tet_count; tet++) patch[tet] = NO_PATCH;
        grow_all(&p);
        dissolve_small(&p);
        renumber(&p);
        *patch_count = p.count;
    } else status = fail(why, TROCAR_NO_MEMORY, "no memory for %zu tetrahedra", tets);
    free(p.grown);
    free(p.first);
    free(p.size);
    return status;
}
