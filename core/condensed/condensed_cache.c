#include "condensed/condensed_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <limits.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "base/folders.h"
#include "base/hash.h"

enum { ALIGNMENT = 64 };     /* bytes, alignment of the matrix in the file */

/* ---- name ------------------------------------------------------------------------------------------------------------- */

static uint64_t key_of(const tissue *t, int count, const int *nodes, bool single) {
    const int facts[] = {CONDENSED_CACHE_VERSION, (int)t->volumetric, single};
    const mesh *m = t->mesh;
    uint64_t h = mesh_hash(hash_bytes(HASH_BASIS, facts, sizeof facts), m);
    for (int g = 0; g < m->group_count; g++) {
        if (m->groups[g].dimension != 3) continue;
        h = hash_bytes(h, &t->materials[g].youngs_modulus, sizeof(double));
        h = hash_bytes(h, &t->materials[g].poisson_ratio, sizeof(double));
    }
    if (t->patch) h = hash_bytes(h, t->patch, (size_t)m->tet_count * sizeof *t->patch);
    h = hash_bytes(h, t->dof, (size_t)m->node_count * sizeof *t->dof);
    h = membrane_hash(h, m, t->membranes);
    h = sliding_hash(h, m, t->sliding);
    return hash_bytes(h, nodes, (size_t)count * sizeof *nodes);
}

condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single) {
    condensed_cache cache = {.key = key_of(t, count, nodes, single)};
    const char *base = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    char usual[1024];
    if (base && base[0] == '/') snprintf(usual, sizeof usual, "%s/trocar", base);
    else snprintf(usual, sizeof usual, "%s/.cache/trocar", home ? home : "");
    snprintf(cache.path, sizeof cache.path, "%s/condensed-%016llx.inverse", directory[0] ? directory : usual, (unsigned long long)cache.key);
    return cache;
}

/* ---- layout ----------------------------------------------------------------------------------------------------------- */

/* The file consists of this header, the nodes, zeros up to the next multiple of ALIGNMENT bytes, and the matrix as it is in memory. It has the byte order of
   the machine that wrote it; on a machine with another byte order, the magic number does not match. */
typedef struct {
    uint64_t magic, key, count, single;
    uint64_t checksum;       /* checksum of the members above, the nodes and the matrix */
} header;

static const uint64_t MAGIC = UINT64_C(0x4b2d7261636f7274); /* "trocar-K" */

static size_t matrix_offset(const symmetric_blocks *matrix) {
    size_t end = sizeof(header) + (size_t)matrix->count * sizeof(int);
    return (end + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

static header header_of(uint64_t key, const int *order, const symmetric_blocks *matrix) {
    header h = {.magic = MAGIC, .key = key, .count = (uint64_t)matrix->count, .single = matrix->single};
    h.checksum = hash_bytes(HASH_BASIS, &h, offsetof(header, checksum));
    h.checksum = hash_bytes(h.checksum, order, (size_t)matrix->count * sizeof *order);
    h.checksum = hash_bytes(h.checksum, matrix->numbers, symmetric_blocks_bytes(matrix->count, matrix->single));
    return h;
}

/* ---- reading ---------------------------------------------------------------------------------------------------------- */

/* Maps a file of exactly `bytes` bytes and reads in all its pages, so that later accesses do not wait for the disk. */
static bool map_file(const char *path, size_t bytes, file_mapping *mapping) {
    struct stat s;
    int file = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    bool whole = file >= 0 && fstat(file, &s) == 0 && S_ISREG(s.st_mode) && (size_t)s.st_size == bytes;
    void *at = whole ? mmap(NULL, bytes, PROT_READ, MAP_SHARED | MAP_POPULATE, file, 0) : MAP_FAILED;
    if (file >= 0) close(file);
    if (at == MAP_FAILED) return false;
    *mapping = (file_mapping){at, bytes};
    return true;
}

cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping) {
    size_t offset = matrix_offset(matrix), bytes = symmetric_blocks_bytes(matrix->count, matrix->single);
    if (access(cache->path, F_OK) != 0) return CACHE_ABSENT;
    if (!map_file(cache->path, offset + bytes, mapping)) return CACHE_DAMAGED;
    matrix->numbers = (char *)mapping->at + offset;
    memcpy(order, (const header *)mapping->at + 1, (size_t)matrix->count * sizeof *order);
    header expected = header_of(cache->key, order, matrix);
    if (memcmp(mapping->at, &expected, sizeof expected) != 0) {
        munmap(mapping->at, mapping->bytes);
        *mapping = (file_mapping){0};
        matrix->numbers = NULL;
        return CACHE_DAMAGED;
    }
    utimensat(AT_FDCWD, cache->path, NULL, 0); /* the modification time serves as the time of last use */
    return CACHE_READ;
}

/* ---- writing ---------------------------------------------------------------------------------------------------------- */

static bool write_file(const char *path, uint64_t key, const int *order, const symmetric_blocks *matrix) {
    static const char zeros[ALIGNMENT];
    header h = header_of(key, order, matrix);
    size_t count = (size_t)matrix->count, gap = matrix_offset(matrix) - sizeof h - count * sizeof *order;
    size_t bytes = symmetric_blocks_bytes(matrix->count, matrix->single);
    FILE *file = fopen(path, "wbxe");
    if (!file) return false;
    bool good = fwrite(&h, sizeof h, 1, file) == 1 && fwrite(order, sizeof *order, count, file) == count && fwrite(zeros, 1, gap, file) == gap
             && fwrite(matrix->numbers, 1, bytes, file) == bytes;
    return fclose(file) == 0 && good;
}

/* ---- room ------------------------------------------------------------------------------------------------------------- */

static bool is_older(const struct timespec *a, const struct timespec *b) {
    return a->tv_sec != b->tv_sec ? a->tv_sec < b->tv_sec : a->tv_nsec < b->tv_nsec;
}

/* Returns the total size in bytes of the cached inverses in a directory, including those of other versions and abandoned temporary files. Sets `oldest` to the
   name of the least recently used file other than `kept`, or to "" if there is none. */
static double survey(DIR *directory, const char *kept, char oldest[NAME_MAX + 1]) {
    double bytes = 0.0;
    struct stat s;
    struct timespec least = {0};
    oldest[0] = '\0';
    rewinddir(directory);
    for (struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        if (fnmatch("condensed-????????????????.*", entry->d_name, 0) != 0 || fstatat(dirfd(directory), entry->d_name, &s, 0) != 0) continue;
        bytes += (double)s.st_size;
        if (strcmp(entry->d_name, kept) == 0 || (oldest[0] && !is_older(&s.st_mtim, &least))) continue;
        least = s.st_mtim;
        strcpy(oldest, entry->d_name);
    }
    return bytes;
}

/* Splits the path into folder and file name, and returns the file name. */
static const char *find_folder(const condensed_cache *cache, char folder[sizeof cache->path]) {
    strcpy(folder, cache->path);
    char *slash = strrchr(folder, '/');
    *slash = '\0';
    return slash + 1;
}

void condensed_cache_trim(const condensed_cache *kept, double bytes) {
    char folder[sizeof kept->path], oldest[NAME_MAX + 1];
    const char *name = find_folder(kept, folder);
    DIR *directory = opendir(folder);
    while (directory && survey(directory, name, oldest) > bytes && oldest[0] && unlinkat(dirfd(directory), oldest, 0) == 0) continue;
    if (directory) closedir(directory);
}

trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, trocar_error *why) {
    char folder[sizeof cache->path];
    struct statvfs room;
    double bytes = (double)symmetric_blocks_bytes(matrix->count, matrix->single);
    find_folder(cache, folder);
    if (!folders_create(folder) || access(folder, W_OK | X_OK) != 0)
        return fail(why, TROCAR_SYSTEM, "%s cannot be written: %s", cache->path, strerror(errno));
    double left = statvfs(folder, &room) == 0 ? (double)room.f_bavail * (double)room.f_frsize : bytes;
    if (left >= bytes) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "%s cannot be written: it takes %.3g GB, and there is room for %.3g GB", cache->path, 1e-9 * bytes, 1e-9 * left);
}

/* Removes temporary files older than OLD. They must have been abandoned: on any machine, writing a file takes less time. */
static void remove_halves(const condensed_cache *cache) {
    static const long OLD = 3600; /* s */
    char folder[sizeof cache->path];
    struct stat s;
    find_folder(cache, folder);
    DIR *directory = opendir(folder);
    for (struct dirent *entry; directory && (entry = readdir(directory)) != NULL;) {
        if (fnmatch("condensed-????????????????.*.????????????????", entry->d_name, 0) != 0) continue;
        if (fstatat(dirfd(directory), entry->d_name, &s, 0) == 0 && time(NULL) - s.st_mtim.tv_sec > OLD) unlinkat(dirfd(directory), entry->d_name, 0);
    }
    if (directory) closedir(directory);
}

trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, trocar_error *why) {
    char beside[sizeof cache->path + 32], folder[sizeof cache->path];
    uint64_t number; /* random, because processes in different containers that share the directory may have the same process id */
    remove_halves(cache);
    find_folder(cache, folder);
    if (getrandom(&number, sizeof number, 0) == sizeof number) {
        snprintf(beside, sizeof beside, "%s.%016llx", cache->path, (unsigned long long)number);
        if (folders_create(folder) && write_file(beside, cache->key, order, matrix) && rename(beside, cache->path) == 0) {
            condensed_cache_trim(cache, CONDENSED_CACHE_ROOM);
            return TROCAR_OK;
        }
        unlink(beside);
    }
    return fail(why, TROCAR_SYSTEM, "%s cannot be written: the next start computes the inverse again; check free space and permissions",
                cache->path);
}
