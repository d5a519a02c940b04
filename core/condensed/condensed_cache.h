/* Caches condensed inverses in files, one for each combination of stiffness matrix, region of interest and precision. Files are mapped rather than read, so
   that processes with the same scene share the memory. They are replaced by renaming, never overwritten: truncating a mapped file would kill the processes
   that use it (SIGBUS). */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "linalg/symmetric_blocks.h"
#include "tissue/tissue.h"

enum { CONDENSED_CACHE_VERSION = 3 }; /* increase this if the file format changes, or if the same mesh, materials and fixed nodes now give a different
                                         stiffness matrix */
static const double CONDENSED_CACHE_ROOM = 8e9; /* bytes, limit on the total size of the files in one directory */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* Returns the cache file for these nodes, this precision and the tissue's stiffness matrix, identified by everything that determines it: the mesh, materials,
   fixed nodes and strain option. K need not be assembled. If `directory` is empty, uses $XDG_CACHE_HOME/trocar or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

typedef struct { void *at; size_t bytes; } file_mapping; /* arguments for munmap */

/* Maps the file, points matrix->numbers at the matrix in it, and reads `order` (matrix->count nodes). Returns CACHE_DAMAGED if the file is truncated, fails its
   checksum or belongs to another matrix. Updates the file's time of last use. */
cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping);

/* Call this before a long computation. Checks that the directory is writable and that the disk has room for a matrix of this size, and creates missing folders.
   SYSTEM. */
trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, trocar_error *why);

/* Writes a temporary file with a unique name and then renames it, so that a partial file is never visible. Also removes temporary files older than an hour, and
   the least recently used files until at most CONDENSED_CACHE_ROOM bytes remain. SYSTEM if the file cannot be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, trocar_error *why);

/* Removes the least recently used files in the directory of `kept`, but never `kept` itself, until their total size is at most `bytes`. */
void condensed_cache_trim(const condensed_cache *kept, double bytes);

#endif
