/* A condensed inverse on disk: HDF5, one file for each stiffness matrix and region of interest. */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "tissue.h"

enum { CONDENSED_CACHE_VERSION = 1 }; /* raise it when the same stiffness matrix gives another file */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* The file in `directory` for this stiffness matrix (and so for mesh, materials, fixed nodes and the option for strain) and
   these nodes. An empty directory: $XDG_CACHE_HOME/trocar, or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

/* Reads `matrix`, 3 count square, and `order`, its `count` nodes. Damaged: there is a file, but it is truncated, fails its
   checksums or belongs to something else. */
cache_state condensed_cache_read(const condensed_cache *cache, int count, int *order, double *matrix);

/* Written beside and renamed: there is never half a file. SYSTEM when it can't be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, int count, const int *order, const double *matrix, report *why);

#endif
