/* Memory of the machine, bytes. */
#ifndef TROCAR_MEMORY_H
#define TROCAR_MEMORY_H

/* All of it; 8 GB where the system does not say. */
double memory_total(void);

/* What this process can have at most: all of it, or the limit of its control group (a container, a service). */
double memory_most(void);

/* Available now, without swapping, also within the limit of its control group; 8 GB where the system does not say. */
double memory_available(void);

/* Limits of a control group and of those that it is in, and what is left of them; INFINITY: none. */
typedef struct { double most, available; } memory_limits;

/* Those of this process, by the files proc/self/cgroup and sys/fs/cgroup in the folder `root` ("": the system's), version 1 or 2. */
memory_limits memory_of_groups(const char *root);

#endif
