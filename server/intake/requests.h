/* Data that the IO thread passes to the haptic thread in addition to the needles' poses: the probe's pose, and clients' requests. */
#ifndef TROCAR_REQUESTS_H
#define TROCAR_REQUESTS_H

#include <stdbool.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* From the IO thread to the haptic thread: the newest pose of the probe */
typedef struct {
    int64_t session;             /* session number of the probe's owner; 0 if nobody owns it */
    int64_t seq;                 /* sequence number of the pose; -1 before the first pose */
    pose base;
} probe_sample;

/* From the IO thread to the haptic thread: a client's request concerning a needle. The haptic thread returns the same struct with the result. */
typedef struct {
    trocar_command_t asked;
    uint64_t engagement;         /* number of the needle's engagement at the time of the request */
    bool anew;                   /* true if the next pose was already due to start a new engagement when the request arrived */
    trocar_change *change;       /* the new values; NULL if the request is not a change */
    trocar_change *replaced;     /* the values before the change, which the IO thread frees when the command returns */
    double change_time;          /* s, duration of the change */
    bool refused;
    char why[256];
} needle_command;

#endif
