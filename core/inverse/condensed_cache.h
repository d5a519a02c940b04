/* A condensed inverse on disk: HDF5, one file for each stiffness matrix and region of interest. */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "tissue/tissue.h"

enum { CONDENSED_CACHE_VERSION = 1 }; /* raise it when the same stiffness matrix gives another file */
static const double CONDENSED_CACHE_ROOM = 8e9; /* bytes that the files of one directory may take */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* The file in `directory` for this stiffness matrix (and so for mesh, materials, fixed nodes and the option for strain) and
   these nodes. An empty directory: $XDG_CACHE_HOME/trocar, or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

/* Reads `matrix`, 3 count square, and `order`, its `count` nodes. Damaged: there is a file, but it is truncated, fails its
   checksums or belongs to something else. One that was read counts as used now. */
cache_state condensed_cache_read(const condensed_cache *cache, int count, int *order, double *matrix);

/* Written beside and renamed: there is never half a file. Then trims to CONDENSED_CACHE_ROOM. SYSTEM when it can't be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, int count, const int *order, const double *matrix, report *why);

/* Removes the least recently used files beside this one, but never this one, until all take no more than so many bytes. */
void condensed_cache_trim(const condensed_cache *kept, double bytes);

#endif
