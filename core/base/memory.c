#include "base/memory.h"

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

enum { LONGEST = 8192 };     /* bytes, longest path supported */

/* Reads the file `name` in `folder` and returns the number in the first line that matches `format`, or `otherwise` if no line does. */
static double read_number(const char *folder, const char *name, const char *format, double otherwise) {
    char path[LONGEST + 64], line[256];
    long long number;
    bool found = false;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "r");
    while (file && !found && fgets(line, sizeof line, file)) found = sscanf(line, format, &number) == 1;
    if (file) fclose(file);
    return found ? (double)number : otherwise;
}

/* ---- control groups --------------------------------------------------------------------------------------------------- */

/* Where one version of control groups (cgroups) keeps its data: its folder below the root; the files with the limit and the memory in use; and the format of
   the line in memory.stat that gives inactive file pages. */
typedef struct { const char *folder, *limit, *used, *inactive; } group_files;
static const group_files VERSION_1 = {"sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file %lld"};
static const group_files VERSION_2 = {"sys/fs/cgroup", "memory.max", "memory.current", "inactive_file %lld"};

/* Lowers `least` to the limits of one group; a limit of "max" means none. The kernel counts inactive file pages as used but reclaims them on demand, so they
   are subtracted. */
static void add_group(const group_files *files, const char *folder, memory_limits *least) {
    double limit = read_number(folder, files->limit, "%lld", INFINITY);
    if (!(limit < INFINITY)) return;
    double used = read_number(folder, files->used, "%lld", 0.0) - read_number(folder, "memory.stat", files->inactive, 0.0);
    least->most = fmin(least->most, limit);
    least->available = fmin(least->available, fmax(0.0, limit - fmax(0.0, used)));
}

/* Lowers `least` to the limits of a group and its ancestors. Inside a container, `path` may be the path on the host; then only the container's own group is
   found. */
static void add_groups(const group_files *files, const char *root, const char *path, memory_limits *least) {
    char folder[LONGEST];
    int base = snprintf(folder, sizeof folder, "%s/%s", root, files->folder);
    if (base < 0 || (size_t)base + strlen(path) >= sizeof folder) return;
    if (!strstr(path, "/..")) strcpy(folder + base, path);
    for (;;) {
        add_group(files, folder, least);
        char *slash = strrchr(folder + base, '/');
        if (!slash) return;
        *slash = '\0';
    }
}

/* True if this comma-separated list contains the memory controller. */
static bool has_memory(const char *controllers) {
    char list[LONGEST + 2];
    snprintf(list, sizeof list, ",%s,", controllers);
    return strstr(list, ",memory,") != NULL;
}

memory_limits memory_of_groups(const char *root) {
    memory_limits least = {INFINITY, INFINITY};
    char line[LONGEST];
    snprintf(line, sizeof line, "%s/proc/self/cgroup", root);
    FILE *file = fopen(line, "r");
    while (file && fgets(line, sizeof line, file)) { /* number:controllers:path */
        char *controllers = strchr(line, ':'), *path = controllers ? strchr(controllers + 1, ':') : NULL;
        if (!path) continue;
        *path++ = '\0';
        path[strcspn(path, "\n")] = '\0';
        if (controllers[1] == '\0') add_groups(&VERSION_2, root, path, &least);
        else if (has_memory(controllers + 1)) add_groups(&VERSION_1, root, path, &least);
    }
    if (file) fclose(file);
    return least;
}

/* ---- all -------------------------------------------------------------------------------------------------------------- */

/* Reads a value in kB from /proc/meminfo and returns it in bytes. */
static double read_meminfo(const char *format) { return 1024.0 * read_number("/proc", "meminfo", format, 8e6); }

double memory_total(void) { return read_meminfo("MemTotal: %lld"); }

double memory_most(void) { return fmin(memory_total(), memory_of_groups("").most); }

double memory_available(void) { return fmin(read_meminfo("MemAvailable: %lld"), memory_of_groups("").available); }
