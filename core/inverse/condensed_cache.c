#include "inverse/condensed_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <hdf5.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* ---- name ------------------------------------------------------------------------------------------------------------- */

/* Fowler, Noll and Vo's hash (FNV-1a), eight bytes at a time; the tail byte by byte. */
static uint64_t hash(uint64_t h, const void *data, size_t bytes) {
    static const uint64_t PRIME = UINT64_C(0x100000001b3);
    const unsigned char *at = data;
    for (; bytes >= 8; bytes -= 8, at += 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        h = (h ^ word) * PRIME;
        h ^= h >> 32;            /* high bits of a word reach the low bits of the hash, too */
    }
    for (; bytes > 0; bytes--, at++) h = (h ^ *at) * PRIME;
    return h;
}

static uint64_t key_of(const tissue *t, int count, const int *nodes) {
    const int version = CONDENSED_CACHE_VERSION;
    const cholmod_sparse *k = t->stiffness;
    size_t entries = (size_t)((const int *)k->p)[k->ncol];
    uint64_t h = hash(UINT64_C(0xcbf29ce484222325), &version, sizeof version);
    h = hash(h, k->p, (k->ncol + 1) * sizeof(int));
    h = hash(h, k->i, entries * sizeof(int));
    h = hash(h, k->x, entries * sizeof(double));
    h = hash(h, t->dof, (size_t)t->mesh->node_count * sizeof *t->dof);
    return hash(h, nodes, (size_t)count * sizeof *nodes);
}

condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes) {
    condensed_cache cache = {.key = key_of(t, count, nodes)};
    const char *base = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    char usual[1024];
    if (base && base[0] == '/') snprintf(usual, sizeof usual, "%s/trocar", base);
    else snprintf(usual, sizeof usual, "%s/.cache/trocar", home ? home : "");
    snprintf(cache.path, sizeof cache.path, "%s/condensed-%016llx.h5", directory[0] ? directory : usual, (unsigned long long)cache.key);
    return cache;
}

/* ---- reading ---------------------------------------------------------------------------------------------------------- */

static bool read_dataset(hid_t file, const char *name, hid_t type, hsize_t numbers, void *into) {
    hid_t set = H5Dopen2(file, name, H5P_DEFAULT), space = set < 0 ? -1 : H5Dget_space(set);
    bool good = space >= 0 && H5Sget_simple_extent_npoints(space) == (hssize_t)numbers
             && H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, into) >= 0;
    if (space >= 0) H5Sclose(space);
    if (set >= 0) H5Dclose(set);
    return good;
}

static void silence(void) { H5Eset_auto2(H5E_DEFAULT, NULL, NULL); } /* HDF5 prints a stack of its own otherwise */

cache_state condensed_cache_read(const condensed_cache *cache, int count, int *order, double *matrix) {
    silence();
    if (access(cache->path, F_OK) != 0) return CACHE_ABSENT;
    hid_t file = H5Fopen(cache->path, H5F_ACC_RDONLY, H5P_DEFAULT);
    if (file < 0) return CACHE_DAMAGED;
    uint64_t key = 0;
    hsize_t n = (hsize_t)count;
    bool good = read_dataset(file, "key", H5T_NATIVE_UINT64, 1, &key) && key == cache->key
             && read_dataset(file, "nodes", H5T_NATIVE_INT, n, order)
             && read_dataset(file, "inverse", H5T_NATIVE_DOUBLE, 9 * n * n, matrix);
    H5Fclose(file);
    if (good) utimensat(AT_FDCWD, cache->path, NULL, 0); /* used now */
    return good ? CACHE_READ : CACHE_DAMAGED;
}

/* ---- writing ---------------------------------------------------------------------------------------------------------- */

static bool make_folders(const char *path) {
    char folder[sizeof((condensed_cache *)0)->path];
    strcpy(folder, path);
    for (char *slash = strchr(folder + 1, '/'); slash; slash = strchr(slash + 1, '/')) {
        *slash = '\0';
        if (mkdir(folder, 0777) != 0 && errno != EEXIST) return false;
        *slash = '/';
    }
    return true;
}

/* In chunks with checksums (Fletcher's). */
static bool write_dataset(hid_t file, const char *name, hid_t stored, hid_t type, int dimensions, const hsize_t *size, const void *data) {
    hsize_t chunk[2] = {size[0], dimensions == 2 ? size[1] : 1};
    while (dimensions == 2 && chunk[0] > 1 && 8 * chunk[0] * chunk[1] > 8u << 20) chunk[0] = (chunk[0] + 1) / 2;
    hid_t space = H5Screate_simple(dimensions, size, NULL), properties = H5Pcreate(H5P_DATASET_CREATE);
    H5Pset_chunk(properties, dimensions, chunk);
    H5Pset_fletcher32(properties);
    hid_t set = H5Dcreate2(file, name, stored, space, H5P_DEFAULT, properties, H5P_DEFAULT);
    bool good = set >= 0 && H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) >= 0;
    if (set >= 0) good = H5Dclose(set) >= 0 && good;
    H5Pclose(properties);
    H5Sclose(space);
    return good;
}

static bool write_file(const char *path, uint64_t key, int count, const int *order, const double *matrix) {
    hid_t file = H5Fcreate(path, H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    if (file < 0) return false;
    hsize_t one[1] = {1}, nodes[1] = {(hsize_t)count}, square[2] = {3 * (hsize_t)count, 3 * (hsize_t)count};
    bool good = write_dataset(file, "key", H5T_STD_U64LE, H5T_NATIVE_UINT64, 1, one, &key)
             && write_dataset(file, "nodes", H5T_STD_I32LE, H5T_NATIVE_INT, 1, nodes, order)
             && write_dataset(file, "inverse", H5T_IEEE_F64LE, H5T_NATIVE_DOUBLE, 2, square, matrix);
    return H5Fclose(file) >= 0 && good;
}

/* ---- room ------------------------------------------------------------------------------------------------------------- */

static bool is_older(const struct timespec *a, const struct timespec *b) {
    return a->tv_sec != b->tv_sec ? a->tv_sec < b->tv_sec : a->tv_nsec < b->tv_nsec;
}

/* Bytes of all cached inverses in a directory, left over halves as well; `oldest` gets the name of the least recently used one but
   for `kept`, or "". */
static double survey(DIR *directory, const char *kept, char oldest[NAME_MAX + 1]) {
    double bytes = 0.0;
    struct stat s;
    struct timespec least = {0};
    oldest[0] = '\0';
    rewinddir(directory);
    for (struct dirent *entry; (entry = readdir(directory)) != NULL;) {
        if (fnmatch("condensed-????????????????.h5*", entry->d_name, 0) != 0 || fstatat(dirfd(directory), entry->d_name, &s, 0) != 0) continue;
        bytes += (double)s.st_size;
        if (strcmp(entry->d_name, kept) == 0 || (oldest[0] && !is_older(&s.st_mtim, &least))) continue;
        least = s.st_mtim;
        strcpy(oldest, entry->d_name);
    }
    return bytes;
}

void condensed_cache_trim(const condensed_cache *kept, double bytes) {
    char folder[sizeof kept->path], oldest[NAME_MAX + 1];
    strcpy(folder, kept->path);
    char *slash = strrchr(folder, '/');
    *slash = '\0';
    DIR *directory = opendir(folder);
    while (directory && survey(directory, slash + 1, oldest) > bytes && oldest[0] && unlinkat(dirfd(directory), oldest, 0) == 0) continue;
    if (directory) closedir(directory);
}

trocar_status condensed_cache_write(const condensed_cache *cache, int count, const int *order, const double *matrix, report *why) {
    char beside[sizeof cache->path + 32];
    silence();
    snprintf(beside, sizeof beside, "%s.%ld", cache->path, (long)getpid());
    if (make_folders(cache->path) && write_file(beside, cache->key, count, order, matrix) && rename(beside, cache->path) == 0) {
        condensed_cache_trim(cache, CONDENSED_CACHE_ROOM);
        return TROCAR_OK;
    }
    unlink(beside);
    return fail(why, TROCAR_SYSTEM, "%s cannot be written: the next start computes the inverse again; is there room, and may one write there?",
                cache->path);
}
