/* Process-wide state of OpenBLAS and OpenMP: number of threads, memory. */
#ifndef TROCAR_BLAS_H
#define TROCAR_BLAS_H

#include "base/error.h"

/* Sets OpenBLAS to one thread. Several threads would compete with the haptic thread for its processor, and their number would change the last bits of results.
   Then reserves memory for one thread as blas_make_room does. NO_MEMORY. */
trocar_status blas_start(trocar_error *why);

/* Returns how many threads OpenBLAS would use by default: the number of processors, or the setting in the environment. Call this after blas_start. */
int blas_own_threads(void);

/* Between these two calls, OpenBLAS uses its default number of threads in the whole process. A second caller waits for the first to end its turn. */
void blas_begin_turn(void);
void blas_end_turn(void);

/* OpenBLAS allocates 128 MB of address space for each thread that calls it, keeps it for later threads, and retries forever if the allocation fails. Call this
   first to make sure that there is room for `threads` threads at once. NO_MEMORY. */
trocar_status blas_make_room(int threads, trocar_error *why);

/* CHOLMOD factorises in OpenMP loops with four threads, which save no time in this program. Worse, libgomp's threads do not survive a fork, after which a loop
   would wait for them forever, and libgomp terminates the process if it cannot start them. Between these two calls, the loops run in the calling thread. */
int openmp_use_one_thread(void);
void openmp_restore(int levels);

#endif
