/* Memory of the machine, bytes. */
#ifndef TROCAR_MEMORY_H
#define TROCAR_MEMORY_H

/* All of it; 8 GB where the system does not say. */
double memory_total(void);

/* What can be had now without swapping, also within a container's limit; 8 GB where the system does not say. */
double memory_available(void);

#endif
