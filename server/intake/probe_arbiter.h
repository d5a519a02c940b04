/* Checks the size, values, owner and order of the probe's poses before they are used. The code uses no network and no clock, as in pose_arbiter.h. */
#ifndef TROCAR_PROBE_ARBITER_H
#define TROCAR_PROBE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/sequence.h"

typedef struct {
    probe_sample newest;     /* last accepted pose; its session owns the probe */
    sequence order;          /* sequence state of the owning session's poses */
    int64_t received;        /* ns, monotonic: arrival time of the last accepted pose */
    int64_t accepted, refused; /* since start */
} probe_arbiter;

void probe_arbiter_init(probe_arbiter *in);

/* Checks the bytes of a probe_pose_t that arrived at `now` (ns, monotonic). If they are valid, stores the pose in `newest` and returns true;
   otherwise returns false and writes the reason to `message`. The session of the first valid pose owns the probe until it is silent for two seconds;
   a silent probe stays where it is. Any speed is accepted, because the probe's force is not rendered to a hand. */
bool probe_arbiter_pose(probe_arbiter *in, const void *data, size_t size, int64_t now, char *message, size_t room);

#endif
