/* What the IO thread passes to the haptic thread besides the needles' poses: the probe's pose, and requests from clients. */
#ifndef TROCAR_REQUESTS_H
#define TROCAR_REQUESTS_H

#include <stdbool.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* From the IO thread to the haptic thread: the newest pose of the probe */
typedef struct {
    int64_t session;             /* session of the probe's owner; 0 if there is none */
    int64_t seq;                 /* sequence number of the pose; -1 before the first */
    pose base;
} probe_sample;

/* A client's request concerning a needle. The IO thread passes it to the haptic thread, which returns it with the result. */
typedef struct {
    trocar_command_t asked;
    uint64_t engagement;         /* number of the needle's engagement when the request was made */
    bool anew;                   /* when the request arrived, the next pose was already due to start a new engagement */
    trocar_change *change;       /* the new values; NULL if the request is not a change */
    trocar_change *replaced;     /* the values before the change; the IO thread frees them when it gets the command back */
    double change_time;          /* s, duration of the change */
    bool refused;
    char why[256];
} needle_command;

#endif
