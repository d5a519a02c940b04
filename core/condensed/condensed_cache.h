/* A file with a condensed inverse: HDF5, one file for each stiffness matrix, region of interest and precision. It is mapped rather than read, so that
   processes with the same scene share it. The file is replaced by renaming, never in place: truncating a mapped file would kill the processes that use it
   (SIGBUS). */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "linalg/symmetric_blocks.h"
#include "tissue/tissue.h"

enum { CONDENSED_CACHE_VERSION = 2 }; /* increase this if the stiffness matrix of the same mesh, materials and fixed nodes, or the file format, changes */
static const double CONDENSED_CACHE_ROOM = 8e9; /* bytes, total size of the files in one directory */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* Path in `directory` of the file for these nodes and for this mesh with its materials, fixed nodes and strain option, which determine the stiffness matrix; K
   need not be assembled. If `directory` is empty: $XDG_CACHE_HOME/trocar, or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

typedef struct { void *at; size_t bytes; } file_mapping; /* arguments for munmap */

/* Maps the whole file, points matrix->numbers into it and reads `order`, the matrix->count nodes. Returns CACHE_DAMAGED if the file is truncated, fails its
   checksums or belongs to another matrix. Marks the file as used. */
cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping);

/* Checks, before a long computation, that the directory is writable and has room for the matrix, of which only the size is used. Creates folders. SYSTEM. */
trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, report *why);

/* Writes a temporary file with a unique name and renames it, so that no partial file is ever visible. Then trims the directory to
   CONDENSED_CACHE_ROOM and removes temporary files that are older than an hour. SYSTEM if the file cannot be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, report *why);

/* Removes the least recently used files in this file's directory, but never this one, until their total size is at most `bytes`. */
void condensed_cache_trim(const condensed_cache *kept, double bytes);

#endif
