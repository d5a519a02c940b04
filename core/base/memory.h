/* How much memory the machine has and this process may use, in bytes. */
#ifndef TROCAR_MEMORY_H
#define TROCAR_MEMORY_H

/* Returns the installed memory; 8 GB if the system does not report it. */
double memory_total(void);

/* Returns the most memory this process may use: the installed memory, or less if its control group (a container or a service) has a lower limit. */
double memory_most(void);

/* Returns the memory available without swapping and within the control group's limit; 8 GB if the system does not report it. */
double memory_available(void);

/* The limits that a control group and its ancestors impose: the lowest limit, and the least memory left under any of them. INFINITY if there is no limit. */
typedef struct { double most, available; } memory_limits;

/* Reads the limits for this process, for control groups of version 1 or 2, from proc/self/cgroup and sys/fs/cgroup in the folder `root` (empty for the real
   system). */
memory_limits memory_of_groups(const char *root);

#endif
