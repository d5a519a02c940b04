#define _GNU_SOURCE /* RTLD_DEFAULT */
#include "tissue/blas.h"

#include <cblas.h>
#include <dlfcn.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <sys/mman.h>

/* Looked up at run time: no header declares these functions, and some builds of the libraries lack them. */
static struct {
    void *(*allocate)(int);
    void (*release)(void *);
    int (*levels)(void);
    void (*set_levels)(int);
} library;

static pthread_once_t found = PTHREAD_ONCE_INIT, started = PTHREAD_ONCE_INIT;
static pthread_mutex_t turn = PTHREAD_MUTEX_INITIALIZER, room = PTHREAD_MUTEX_INITIALIZER;
static int own_threads;

/* A fork copies no other thread to the child, so nothing there would release a lock held at that moment. */
static void forget_threads(void) {
    pthread_mutex_init(&turn, NULL);
    pthread_mutex_init(&room, NULL);
    if (openblas_get_num_threads() != 1) openblas_set_num_threads(1); /* only if needed: the call starts OpenBLAS's threads in the child, which spin for 0.2 s */
}

static void find_functions(void) {
    *(void **)&library.allocate = dlsym(RTLD_DEFAULT, "blas_memory_alloc");
    *(void **)&library.release = dlsym(RTLD_DEFAULT, "blas_memory_free");
    *(void **)&library.levels = dlsym(RTLD_DEFAULT, "omp_get_max_active_levels");
    *(void **)&library.set_levels = dlsym(RTLD_DEFAULT, "omp_set_max_active_levels");
}

static void start(void) {
    own_threads = openblas_get_num_threads();
    openblas_set_num_threads(1);
    pthread_atfork(NULL, NULL, forget_threads);
}

trocar_status blas_start(trocar_error *why) {
    pthread_once(&started, start);
    return blas_make_room(1, why);
}

int blas_own_threads(void) { return own_threads; }

void blas_begin_turn(void) {
    pthread_mutex_lock(&turn);
    openblas_set_num_threads(own_threads);
}

void blas_end_turn(void) {
    openblas_set_num_threads(1);
    pthread_mutex_unlock(&turn);
}

/* ---- memory ----------------------------------------------------------------------------------------------------------- */

enum { MOST_BUFFERS = 32 };             /* OpenBLAS has room for about a hundred buffers and terminates the process if it needs more */
static const size_t BUFFER = 128 << 20; /* bytes in an OpenBLAS buffer on this type of processor */
static const size_t ELSE = 16 << 20;    /* bytes left for the caller's own allocations */

static bool has_room(size_t bytes) {
    void *probe = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (probe == MAP_FAILED) return false;
    munmap(probe, bytes);
    return true;
}

/* Makes OpenBLAS's own threads allocate their buffers now, by means of a matrix product large enough to use them all. Otherwise each thread allocates its
   buffer when it first runs, which may be much later. */
static void run_own_threads(void) {
    enum { SIZE = 256 };
    double *product = calloc(SIZE * SIZE, sizeof *product);
    if (!product || own_threads < 2) { free(product); return; }
    blas_begin_turn();
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, SIZE, SIZE, SIZE, 0.0, product, SIZE, product, SIZE, 1.0, product, SIZE);
    blas_end_turn();
    free(product);
}

/* Allocates `count` buffers. Buffers held at the same time are distinct, and OpenBLAS keeps them all for later use. */
static void fill_table(int count) {
    void *buffer[MOST_BUFFERS];
    for (int i = 0; i < count; i++) buffer[i] = library.allocate(0);
    for (int i = 0; i < count; i++) library.release(buffer[i]);
}

trocar_status blas_make_room(int threads, trocar_error *why) {
    static int there;
    int wanted = threads < MOST_BUFFERS ? threads : MOST_BUFFERS;
    trocar_status status = TROCAR_OK;
    pthread_once(&found, find_functions);
    if (!library.allocate || !library.release) return TROCAR_OK;
    pthread_mutex_lock(&room);
    int more = wanted - there + (there == 0 ? own_threads - 1 : 0);
    if (wanted > there) status = has_room((size_t)more * BUFFER + ELSE) ? TROCAR_OK : TROCAR_NO_MEMORY;
    if (status == TROCAR_OK && there == 0) run_own_threads();
    if (status == TROCAR_OK && wanted > there) fill_table(there = wanted);
    pthread_mutex_unlock(&room);
    if (status == TROCAR_OK) return status;
    return fail(why, status, "too little address space: the algebra takes %zu MB for each thread that computes, here for %d: raise ulimit -v, or set OPENBLAS_NUM_THREADS=1",
        BUFFER >> 20, more);
}

/* ---- OpenMP ----------------------------------------------------------------------------------------------------------- */

int openmp_use_one_thread(void) {
    pthread_once(&found, find_functions);
    if (!library.levels || !library.set_levels) return 0;
    int levels = library.levels();
    library.set_levels(0);
    return levels;
}

void openmp_restore(int levels) {
    if (library.set_levels) library.set_levels(levels);
}
