/* Process-wide state of OpenBLAS and OpenMP: number of threads, and memory. */
#ifndef TROCAR_BLAS_H
#define TROCAR_BLAS_H

#include "base/error.h"

/* Sets OpenBLAS to one thread: several threads would compete with the haptic thread for its processor, and their number would change the last bits of
   results. Then reserves memory for one thread in the same way as blas_make_room. NO_MEMORY. */
trocar_status blas_start(trocar_error *why);

/* Number of threads that OpenBLAS would use by default: the number of processors, or the setting in the environment. To be called after blas_start. */
int blas_own_threads(void);

/* Between these two calls, OpenBLAS uses its default number of threads in the whole process. Callers take turns. */
void blas_begin_turn(void);
void blas_end_turn(void);

/* OpenBLAS allocates 128 MB of address space for each thread that calls it, keeps it for later threads, and retries forever if the allocation fails. This
   function checks in advance that there is room for `threads` concurrent threads. NO_MEMORY. */
trocar_status blas_make_room(int threads, trocar_error *why);

/* CHOLMOD factorises in OpenMP loops with four threads, which save no time in this program. Moreover, libgomp's threads do not survive a fork, after which
   a loop would wait for them forever, and libgomp terminates the process if it cannot start them. Between these two calls, the loops run in the calling
   thread. */
int openmp_use_one_thread(void);
void openmp_restore(int levels);

#endif
