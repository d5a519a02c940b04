/* Records the failure of the lowest-numbered row or insertion, in whatever order the threads report failures. */
#ifndef TROCAR_FIRST_FAILURE_H
#define TROCAR_FIRST_FAILURE_H

#include <limits.h>
#include <pthread.h>

#include "base/error.h"

typedef struct {
    pthread_mutex_t lock;    /* protects the members below while several threads run */
    int index;               /* index of the failed row or insertion */
    trocar_status status;    /* TROCAR_OK if none has failed */
    trocar_error why;
} first_failure;

static inline void first_failure_clear(first_failure *f) {
    f->index = INT_MAX;
    f->status = TROCAR_OK;
}

static inline void first_failure_create(first_failure *f) {
    pthread_mutex_init(&f->lock, NULL);
    first_failure_clear(f);
}

static inline void first_failure_free(first_failure *f) { pthread_mutex_destroy(&f->lock); }

static inline void first_failure_note(first_failure *f, int index, trocar_status status, const trocar_error *why) {
    pthread_mutex_lock(&f->lock);
    if (index < f->index) {
        f->index = index;
        f->status = status;
        f->why = *why;
    }
    pthread_mutex_unlock(&f->lock);
}

#endif
