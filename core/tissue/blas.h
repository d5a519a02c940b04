/* State of OpenBLAS and OpenMP that the process shares: the number of their threads, and their memory. */
#ifndef TROCAR_BLAS_H
#define TROCAR_BLAS_H

#include "base/report.h"

/* Sets OpenBLAS to one thread: its threads would compete with the haptic thread for its processor, and the last bits would depend on their number.
   Then makes room for one thread, like blas_make_room. NO_MEMORY. */
trocar_status blas_start(report *why);

/* The number of threads that OpenBLAS chooses by default: processors, or as the environment says. Call after blas_start. */
int blas_own_threads(void);

/* Between these calls OpenBLAS uses that many threads, in the whole process; callers take turns. */
void blas_begin_turn(void);
void blas_end_turn(void);

/* OpenBLAS takes 128 MB of address space for each thread inside it, keeps them for later threads, and retries for ever if there are none. This makes
   sure beforehand that there is room for this many of our threads at a time. NO_MEMORY. */
trocar_status blas_make_room(int threads, report *why);

/* CHOLMOD factorises in OpenMP loops with four threads. They gain nothing; libgomp's threads do not survive a fork, after which the loop would wait
   for them for ever; and libgomp ends the process if it cannot start them. Between these two calls the loops run in the calling thread. */
int openmp_use_one_thread(void);
void openmp_restore(int levels);

#endif
