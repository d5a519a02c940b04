/* A condensed inverse on disk: HDF5, one file for each stiffness matrix, region of interest and precision. It is mapped into memory
   rather than read, so that processes with the same scene share it: replace it by renaming, never in place, because truncating a mapped
   file ends the processes that use it (SIGBUS). */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "linalg/symmetric_blocks.h"
#include "tissue/tissue.h"

enum { CONDENSED_CACHE_VERSION = 2 }; /* raise it when the same mesh, materials and fixed nodes give another stiffness matrix or another file */
static const double CONDENSED_CACHE_ROOM = 8e9; /* bytes that the files of one directory may take */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* The file in `directory` for this mesh with these materials, fixed nodes and option for strain (on which the stiffness matrix depends, which
   need not be there), and these nodes. An empty directory: $XDG_CACHE_HOME/trocar, or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

typedef struct { void *at; size_t bytes; } file_mapping; /* for munmap */

/* Maps the file, whole, and points matrix->numbers into it; reads `order`, the matrix->count nodes. Damaged: there is a file, but it is
   truncated, fails its checksums or belongs to something else. One that was read counts as used now. */
cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping);

/* Before a long computation: may one write there, and is there room for the matrix, of which only the size is needed? SYSTEM. Makes the folders. */
trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, report *why);

/* Written beside, under a name of its own, and renamed: there is never half a file. Then trims to CONDENSED_CACHE_ROOM. Halves that ended
   programs left an hour ago or earlier are removed. SYSTEM when it can't be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, report *why);

/* Removes the least recently used files beside this one, but never this one, until all take no more than so many bytes. */
void condensed_cache_trim(const condensed_cache *kept, double bytes);

#endif
