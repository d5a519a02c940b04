/* What passes from the IO thread to the haptic thread beside the needles' poses: the probe's pose, and requests. */
#ifndef TROCAR_REQUESTS_H
#define TROCAR_REQUESTS_H

#include <stdbool.h>
#include <stdint.h>

#include "base/vec.h"
#include "trocar_command_t.h"

/* IO -> haptic: the newest pose of the probe */
typedef struct {
    int64_t session;             /* session of its owner, 0: nobody */
    int64_t seq;                 /* -1 before the first */
    pose base;
} probe_sample;

/* IO -> haptic: a client's request concerning a needle; haptic -> IO: the same, with its result */
typedef struct {
    trocar_command_t asked;
    uint64_t engagement;         /* the needle's engagement at the time of the request */
    bool anew;                   /* before the request, the next pose was already going to start a new engagement */
    bool refused;
    char why[256];
} needle_command;

#endif
