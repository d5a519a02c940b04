/* Memory of the machine and of this process, in bytes. */
#ifndef TROCAR_MEMORY_H
#define TROCAR_MEMORY_H

/* Installed memory; 8 GB if the system does not report it. */
double memory_total(void);

/* Maximum amount of memory that this process may use: the installed memory, or the limit of its control group (a container or a service). */
double memory_most(void);

/* Memory that is available without swapping, within the limit of the control group; 8 GB if the system does not report it. */
double memory_available(void);

/* Limits that apply to a process, over its control group and all ancestors: the lowest limit, and the smallest unused part of any limit. INFINITY if there is
   no limit. */
typedef struct { double most, available; } memory_limits;

/* Returns the limits of this process for version 1 or 2 of control groups, read from proc/self/cgroup and sys/fs/cgroup below the folder `root` (empty for
   the real system). */
memory_limits memory_of_groups(const char *root);

#endif
