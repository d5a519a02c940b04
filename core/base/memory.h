/* Memory of the machine, in bytes. */
#ifndef TROCAR_MEMORY_H
#define TROCAR_MEMORY_H

/* Installed memory; 8 GB if the system does not report it. */
double memory_total(void);

/* Largest amount of memory for this process: installed memory, or the limit of its control group (a container, a service). */
double memory_most(void);

/* Memory available without swapping, within the limit of the control group; 8 GB if the system does not report it. */
double memory_available(void);

/* The tightest limit of a control group and its ancestors, and its unused part; INFINITY: no limit. */
typedef struct { double most, available; } memory_limits;

/* Limits of this process, from the files proc/self/cgroup and sys/fs/cgroup in the folder `root` ("": that of the system), version 1 or 2. */
memory_limits memory_of_groups(const char *root);

#endif
