/* Checks changes to the tissue during a run, and keeps track of the current values. */
#ifndef TROCAR_CHANGES_H
#define TROCAR_CHANGES_H

#include <pthread.h>
#include <stdatomic.h>
#include <stddef.h>

#include "intake/requests.h"
#include "trocar_values_t.h"

enum { CHANGE_TEXT_MOST = 512 }; /* maximum number of bytes in change_t.values, not counting the terminating zero */

typedef struct {
    trocar_change *newest;       /* values that the simulation uses or is about to use; NULL if nothing can be changed */
    bool pending;                /* the haptic thread has not yet returned the last change */
    bool busy;                   /* a change has been read since the IO thread last cleared this. Reading another one now could delay the wrenches */
    int wake;                    /* eventfd to signal when a model is ready; set by the creator of this struct */
    needle_command last;         /* the pending change. If it changes moduli, a separate thread builds a model with them first */
    bool building;
    pthread_t builder;
    atomic_bool built, cancelled;
    trocar_status status;        /* what the builder thread returned; valid once `built` is true */
    trocar_error why;
    trocar_values_t shown;       /* the current values, for clients; `utime` and `server` are not filled in */
} change_intake;

/* Starts with the values of a simulation that no other thread uses yet. NO_MEMORY. */
trocar_status changes_create(change_intake *in, const trocar_sim *sim, trocar_error *why);

typedef enum {
    CHANGE_MALFORMED,            /* not a change_t of this version, so there is nobody to reply to */
    CHANGE_REFUSED,              /* command->why gives the reason */
    CHANGE_LATER,                /* a model is being built, which can take from a second to hours; see changes_ready */
    CHANGE_PASS_ON,              /* the haptic thread must carry out `command`, after which the IO thread calls changes_settle */
} change_verdict;

/* Checks the bytes of a change_t. Allocates, and parses the text. */
change_verdict changes_take(change_intake *in, const void *data, size_t size, needle_command *command);

/* Returns the verdict on a change of moduli once its model is built. Until then, or if there is no such change, returns CHANGE_LATER. */
change_verdict changes_ready(change_intake *in, needle_command *command);

/* Frees the values that a change has replaced. Call this once the haptic thread has carried it out. */
void changes_settle(change_intake *in, const needle_command *done);

/* Cancels and frees everything. Call changes_settle first for each command that is not settled. `in` may be all zero. */
void changes_free(change_intake *in);

#endif
