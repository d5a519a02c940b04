/* Checks changes to the tissue during the run, and keeps the newest values. */
#ifndef TROCAR_CHANGES_H
#define TROCAR_CHANGES_H

#include <pthread.h>
#include <stdatomic.h>
#include <stddef.h>

#include "intake/requests.h"
#include "trocar_values_t.h"

enum { CHANGE_TEXT_MOST = 512 }; /* maximum number of bytes in change_t.values, without the terminating zero */

typedef struct {
    trocar_change *newest;       /* values that the simulation uses or is about to use; NULL if nothing can be changed */
    bool pending;                /* the haptic thread has not returned the last change yet */
    bool busy;                   /* a change has been read since the IO thread last set this to false: reading another one could delay the wrenches */
    int wake;                    /* eventfd signalled when a model is ready; set by the creator of this struct */
    needle_command last;         /* the pending change; if it changes moduli, a separate thread first builds a model with them */
    bool building;
    pthread_t builder;
    atomic_bool built, cancelled;
    trocar_status status;        /* result of the builder thread; valid once `built` is true */
    trocar_error why;
    trocar_values_t shown;       /* the newest values, for clients; `utime` and `server` are not set */
} change_intake;

/* Initialises the intake with the values of a simulation that no other thread uses yet. NO_MEMORY. */
trocar_status changes_create(change_intake *in, const trocar_sim *sim, trocar_error *why);

typedef enum {
    CHANGE_MALFORMED,            /* not a change_t of this version, so no reply is possible */
    CHANGE_REFUSED,              /* command->why gives the reason */
    CHANGE_LATER,                /* a model is being built, which may take from a second to hours: see changes_ready */
    CHANGE_PASS_ON,              /* the haptic thread must carry out `command`; the IO thread then calls changes_settle */
} change_verdict;

/* Checks the bytes of a change_t. Allocates, and parses the text. */
change_verdict changes_take(change_intake *in, const void *data, size_t size, needle_command *command);

/* Returns the verdict on a change of moduli once their model has been built; CHANGE_LATER before that, or if there is no such change. */
change_verdict changes_ready(change_intake *in, needle_command *command);

/* Frees the replaced values after the haptic thread has carried out a change. */
void changes_settle(change_intake *in, const needle_command *done);

/* Cancels and frees everything; to be called after changes_settle for each command that has not been settled. `in` may be zero. */
void changes_free(change_intake *in);

#endif
