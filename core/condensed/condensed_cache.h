/* A file with a condensed inverse; one file for each stiffness matrix, region of interest and precision. It is mapped rather than read, so that
   processes with the same scene share it. A file is replaced by renaming, never overwritten: truncating a mapped file would kill the processes that use it
   (SIGBUS). */
#ifndef TROCAR_CONDENSED_CACHE_H
#define TROCAR_CONDENSED_CACHE_H

#include "linalg/symmetric_blocks.h"
#include "tissue/tissue.h"

enum { CONDENSED_CACHE_VERSION = 3 }; /* to be increased if the file format changes, or the stiffness matrix for the same mesh, materials and fixed nodes */
static const double CONDENSED_CACHE_ROOM = 8e9; /* bytes, total size of the files in one directory */

typedef struct { char path[1200]; uint64_t key; } condensed_cache;

/* Finds the path in `directory` of the file for these nodes and for everything that determines the stiffness matrix: the mesh with its materials, fixed
   nodes and strain option. K need not be assembled. If `directory` is empty, it is $XDG_CACHE_HOME/trocar or ~/.cache/trocar. */
condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single);

typedef enum { CACHE_READ, CACHE_ABSENT, CACHE_DAMAGED } cache_state;

typedef struct { void *at; size_t bytes; } file_mapping; /* arguments for munmap */

/* Maps the whole file, sets matrix->numbers to the place of the matrix in it and reads `order` (the matrix->count nodes). Returns CACHE_DAMAGED if the
   file is truncated, fails its checksums or belongs to another matrix. Records that the file was used. */
cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping);

/* To be called before a long computation: checks that the directory is writable and has room for the matrix, of which only the size is read. Creates
   folders. SYSTEM. */
trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, trocar_error *why);

/* Writes a temporary file with a unique name and then renames it, so that no partial file is ever visible. Afterwards removes files until the directory
   has at most CONDENSED_CACHE_ROOM bytes, and temporary files that are older than an hour. SYSTEM if the file cannot be written. */
trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, trocar_error *why);

/* Removes the least recently used files in the directory of this file, but never this file, until their total size is at most `bytes`. */
void condensed_cache_trim(const condensed_cache *kept, double bytes);

#endif
