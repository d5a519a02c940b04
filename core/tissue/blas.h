/* What the process shares of OpenBLAS and OpenMP: the number of their threads, and their memory. */
#ifndef TROCAR_BLAS_H
#define TROCAR_BLAS_H

#include "base/report.h"

/* OpenBLAS with one thread: its threads would compete with the haptic thread for its processor, and the last bits would depend on their
   number. Then makes sure of room for one thread, as blas_make_room. NO_MEMORY. */
trocar_status blas_start(report *why);

/* As many threads as OpenBLAS takes by itself: processors, or what the environment says. After blas_start. */
int blas_own_threads(void);

/* Between these OpenBLAS has that many threads, in the whole process, and callers take turns. */
void blas_begin_turn(void);
void blas_end_turn(void);

/* OpenBLAS takes 128 MB of address space for each thread that is in it, keeps them for the next one, and where there are none it tries again
   for ever. This makes sure, before it is called, that there is room for so many threads of ours at a time. NO_MEMORY. */
trocar_status blas_make_room(int threads, report *why);

/* CHOLMOD factorises in loops of OpenMP with four threads. They gain nothing, but libgomp's threads do not survive a fork, after which
   the loop waits for them for ever, and where they cannot be started libgomp ends the process. Between these two the loops run in the calling
   thread. */
int openmp_use_one_thread(void);
void openmp_restore(int levels);

#endif
