#include "resting/unresolved_cache.h"

#include <stdlib.h>
#include <string.h>

void unresolved_cache_free(unresolved_cache *c) {
    for (int i = 0; i < c->count; i++) free(c->pieces[i].lacks);
    free(c->pieces);
    *c = (unresolved_cache){0};
}

static bool same_piece(const shaft_piece *a, const shaft_piece *b) {
    return a->from == b->from && a->to == b->to && a->depth == b->depth && v3_same(a->place, b->place) && v3_same(a->direction, b->direction) &&
           line_same(&a->line, &b->line);
}

static bool make_room(unresolved_cache *c, int count) {
    if (count <= c->count) return true;
    struct known_piece *wider = realloc(c->pieces, (size_t)count * sizeof *wider);
    if (!wider) return false;
    memset(wider + c->count, 0, (size_t)(count - c->count) * sizeof *wider);
    c->pieces = wider;
    c->count = count;
    return true;
}

static trocar_status compute(struct known_piece *p, needle_pairs *pairs, const resting_needle *r, const shaft_piece *piece, trocar_error *why) {
    mat3 lacks[MAX_LOADS];
    bool any;
    p->known = false;
    trocar_status status = resting_lacks(pairs, r, piece, lacks, &any, why);
    if (status != TROCAR_OK) return status;
    size_t size = (size_t)r->places.count * sizeof *lacks;
    if (any && !p->lacks && !(p->lacks = malloc(size))) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    if (any) memcpy(p->lacks, lacks, size);
    else {
        free(p->lacks);
        p->lacks = NULL;
    }
    p->piece = *piece;
    p->known = true;
    return TROCAR_OK;
}

trocar_status unresolved_cache_find(unresolved_cache *c, needle_pairs *pairs, const resting_needle *r, int index, const shaft_piece *piece, const mat3 **lacks,
                                    trocar_error *why) {
    if (!make_room(c, index + 1)) return fail(why, TROCAR_NO_MEMORY, "no memory for a resting needle");
    struct known_piece *p = &c->pieces[index];
    trocar_status status = p->known && same_piece(&p->piece, piece) ? TROCAR_OK : compute(p, pairs, r, piece, why);
    *lacks = p->lacks;
    return status;
}
