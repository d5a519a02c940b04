/* Disjoint sets of numbered things (union-find). parent[i] links i towards the root of its set, which is its lowest member; initially, parent[i] is i. */
#ifndef TROCAR_UNION_FIND_H
#define TROCAR_UNION_FIND_H

/* Returns the root of a thing's set, and shortens the way to it. */
static inline int union_root(int *parent, int thing) {
    while (parent[thing] != thing) thing = parent[thing] = parent[parent[thing]];
    return thing;
}

static inline void union_join(int *parent, int a, int b) {
    a = union_root(parent, a), b = union_root(parent, b);
    if (a < b) parent[b] = a;
    else parent[a] = b;
}

#endif
