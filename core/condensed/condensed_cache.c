#include "condensed/condensed_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <fnmatch.h>
#include <hdf5.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "base/hash.h"

enum { ALIGNMENT = 64 };     /* bytes, alignment of all datasets in the file */

/* ---- name ------------------------------------------------------------------------------------------------------------- */

static uint64_t key_of(const tissue *t, int count, const int *nodes, bool single) {
    const int facts[] = {CONDENSED_CACHE_VERSION, (int)t->volumetric, single};
    const mesh *m = t->mesh;
    size_t node_count = (size_t)m->node_count, tets = (size_t)m->tet_count;
    uint64_t h = hash_bytes(HASH_BASIS, facts, sizeof facts);
    h = hash_bytes(h, m->nodes, node_count * sizeof *m->nodes);
    h = hash_bytes(h, m->tets, tets * sizeof *m->tets);
    h = hash_bytes(h, m->region, tets * sizeof *m->region);
    for (int g = 0; g < m->group_count; g++) {
        if (m->groups[g].dimension != 3) continue;
        h = hash_bytes(h, &t->materials[g].youngs_modulus, sizeof(double));
        h = hash_bytes(h, &t->materials[g].poisson_ratio, sizeof(double));
    }
    if (t->patch) h = hash_bytes(h, t->patch, tets * sizeof *t->patch);
    h = hash_bytes(h, t->dof, node_count * sizeof *t->dof);
    return hash_bytes(h, nodes, (size_t)count * sizeof *nodes);
}

condensed_cache condensed_cache_find(const char *directory, const tissue *t, int count, const int *nodes, bool single) {
    condensed_cache cache = {.key = key_of(t, count, nodes, single)};
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

/* Returns the offset in the file of a dataset that has this number of bytes; HADDR_UNDEF if its size differs or it is not contiguous. */
static haddr_t offset_of(hid_t file, const char *name, size_t bytes) {
    hid_t set = H5Dopen2(file, name, H5P_DEFAULT);
    if (set < 0) return HADDR_UNDEF;
    haddr_t offset = H5Dget_storage_size(set) == bytes ? H5Dget_offset(set) : HADDR_UNDEF;
    H5Dclose(set);
    return offset;
}

/* Reads all pages at once, so that later accesses do not wait for the disk. */
static bool map_file(const char *path, size_t bytes, file_mapping *mapping) {
    struct stat s;
    int file = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    bool long_enough = file >= 0 && fstat(file, &s) == 0 && (size_t)s.st_size >= bytes;
    void *at = long_enough ? mmap(NULL, bytes, PROT_READ, MAP_SHARED | MAP_POPULATE, file, 0) : MAP_FAILED;
    if (file >= 0) close(file);
    if (at == MAP_FAILED) return false;
    *mapping = (file_mapping){at, bytes};
    return true;
}

static void silence(void) { H5Eset_auto2(H5E_DEFAULT, NULL, NULL); } /* suppresses HDF5's own error output */

cache_state condensed_cache_map(const condensed_cache *cache, int *order, symmetric_blocks *matrix, file_mapping *mapping) {
    silence();
    struct stat status;
    if (stat(cache->path, &status) != 0) return CACHE_ABSENT;
    if (!S_ISREG(status.st_mode)) return CACHE_DAMAGED;
    hid_t file = H5Fopen(cache->path, H5F_ACC_RDONLY, H5P_DEFAULT);
    if (file < 0) return CACHE_DAMAGED;
    uint64_t key = 0, checksum = 0;
    size_t bytes = symmetric_blocks_bytes(matrix->count, matrix->single);
    haddr_t offset = HADDR_UNDEF;
    bool good = read_dataset(file, "key", H5T_NATIVE_UINT64, 1, &key) && key == cache->key
             && read_dataset(file, "nodes", H5T_NATIVE_INT, (hsize_t)matrix->count, order)
             && read_dataset(file, "checksum", H5T_NATIVE_UINT64, 1, &checksum)
             && (offset = offset_of(file, "inverse", bytes)) != HADDR_UNDEF && offset % ALIGNMENT == 0;
    H5Fclose(file);
    if (!good || !map_file(cache->path, (size_t)offset + bytes, mapping)) return CACHE_DAMAGED;
    matrix->numbers = (char *)mapping->at + offset;
    if (hash_bytes(HASH_BASIS, matrix->numbers, bytes) != checksum) {
        munmap(mapping->at, mapping->bytes);
        *mapping = (file_mapping){0};
        matrix->numbers = NULL;
        return CACHE_DAMAGED;
    }
    utimensat(AT_FDCWD, cache->path, NULL, 0); /* sets the time at which the file was last used */
    return CACHE_READ;
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

typedef struct {
    const char *name;
    hid_t type;              /* identical in the file and in memory, so that the file can be mapped */
    hsize_t count;
    const void *data;
} dataset;

/* Writes a dataset. If it will be mapped, it is contiguous; otherwise it is one chunk with a checksum (Fletcher). */
static bool write_dataset(hid_t file, const dataset *d, bool mapped) {
    hid_t space = H5Screate_simple(1, &d->count, NULL), properties = H5Pcreate(H5P_DATASET_CREATE);
    if (!mapped) {
        H5Pset_chunk(properties, 1, &d->count);
        H5Pset_fletcher32(properties);
    }
    hid_t set = H5Dcreate2(file, d->name, d->type, space, H5P_DEFAULT, properties, H5P_DEFAULT);
    bool good = set >= 0 && H5Dwrite(set, d->type, H5S_ALL, H5S_ALL, H5P_DEFAULT, d->data) >= 0;
    if (set >= 0) good = H5Dclose(set) >= 0 && good;
    H5Pclose(properties);
    H5Sclose(space);
    return good;
}

static bool write_file(const char *path, uint64_t key, const int *order, const symmetric_blocks *matrix) {
    hid_t access = H5Pcreate(H5P_FILE_ACCESS);
    H5Pset_alignment(access, 0, ALIGNMENT);
    hid_t file = H5Fcreate(path, H5F_ACC_EXCL, H5P_DEFAULT, access);
    H5Pclose(access);
    if (file < 0) return false;
    uint64_t checksum = hash_bytes(HASH_BASIS, matrix->numbers, symmetric_blocks_bytes(matrix->count, matrix->single));
    hid_t type = matrix->single ? H5T_NATIVE_FLOAT : H5T_NATIVE_DOUBLE;
    bool good = write_dataset(file, &(dataset){"key", H5T_NATIVE_UINT64, 1, &key}, false)
             && write_dataset(file, &(dataset){"nodes", H5T_NATIVE_INT, (hsize_t)matrix->count, order}, false)
             && write_dataset(file, &(dataset){"checksum", H5T_NATIVE_UINT64, 1, &checksum}, false)
             && write_dataset(file, &(dataset){"inverse", type, symmetric_blocks_numbers(matrix->count), matrix->numbers}, true);
    return H5Fclose(file) >= 0 && good;
}

/* ---- room ------------------------------------------------------------------------------------------------------------- */

static bool is_older(const struct timespec *a, const struct timespec *b) {
    return a->tv_sec != b->tv_sec ? a->tv_sec < b->tv_sec : a->tv_nsec < b->tv_nsec;
}

/* Returns the total bytes of the cached inverses in a directory, including abandoned temporary files. `oldest` receives the name of the least recently
   used file other than `kept`, or "". */
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

/* Separates the folder from the file name and returns the latter. */
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

trocar_status condensed_cache_check(const condensed_cache *cache, const symmetric_blocks *matrix, report *why) {
    char folder[sizeof cache->path];
    struct statvfs room;
    double bytes = (double)symmetric_blocks_bytes(matrix->count, matrix->single);
    find_folder(cache, folder);
    if (!make_folders(cache->path) || access(folder, W_OK | X_OK) != 0)
        return fail(why, TROCAR_SYSTEM, "%s cannot be written: %s", cache->path, strerror(errno));
    double left = statvfs(folder, &room) == 0 ? (double)room.f_bavail * (double)room.f_frsize : bytes;
    if (left >= bytes) return TROCAR_OK;
    return fail(why, TROCAR_SYSTEM, "%s cannot be written: it takes %.3g GB, and there is room for %.3g GB", cache->path, 1e-9 * bytes, 1e-9 * left);
}

/* Removes abandoned temporary files. On any machine, writing a file takes less time than OLD. */
static void remove_halves(const condensed_cache *cache) {
    static const long OLD = 3600; /* s */
    char folder[sizeof cache->path];
    struct stat s;
    find_folder(cache, folder);
    DIR *directory = opendir(folder);
    for (struct dirent *entry; directory && (entry = readdir(directory)) != NULL;) {
        if (fnmatch("condensed-????????????????.h5.????????????????", entry->d_name, 0) != 0) continue;
        if (fstatat(dirfd(directory), entry->d_name, &s, 0) == 0 && time(NULL) - s.st_mtim.tv_sec > OLD) unlinkat(dirfd(directory), entry->d_name, 0);
    }
    if (directory) closedir(directory);
}

trocar_status condensed_cache_write(const condensed_cache *cache, const int *order, const symmetric_blocks *matrix, report *why) {
    char beside[sizeof cache->path + 32];
    uint64_t number; /* random, because processes in different containers that share the directory may have the same id */
    silence();
    remove_halves(cache);
    if (getrandom(&number, sizeof number, 0) == sizeof number) {
        snprintf(beside, sizeof beside, "%s.%016llx", cache->path, (unsigned long long)number);
        if (make_folders(cache->path) && write_file(beside, cache->key, order, matrix) && rename(beside, cache->path) == 0) {
            condensed_cache_trim(cache, CONDENSED_CACHE_ROOM);
            return TROCAR_OK;
        }
        unlink(beside);
    }
    return fail(why, TROCAR_SYSTEM, "%s cannot be written: the next start computes the inverse again; check free space and permissions",
                cache->path);
}
