#include "base/memory.h"

#include <math.h>
#include <stdio.h>

/* A line of /proc/meminfo. */
static double read_line(const char *format) {
    double kilobytes = 8e6;
    char line[128];
    FILE *file = fopen("/proc/meminfo", "r");
    while (file && fgets(line, sizeof line, file) && sscanf(line, format, &kilobytes) != 1) continue;
    if (file) fclose(file);
    return 1024.0 * kilobytes;
}

static double read_limit(const char *path) {
    double bytes = INFINITY;
    FILE *file = fopen(path, "r");
    if (file && fscanf(file, "%lf", &bytes) != 1) bytes = INFINITY;
    if (file) fclose(file);
    return bytes;
}

double memory_total(void) { return read_line("MemTotal: %lf"); }

double memory_available(void) { return fmin(read_line("MemAvailable: %lf"), read_limit("/sys/fs/cgroup/memory.max")); } /* "max": no limit */
