/* Checks the probe's poses before they are used: their size, values, owner and order. Like pose_arbiter.h, doesn't touch the network or the clock. */
#ifndef TROCAR_PROBE_ARBITER_H
#define TROCAR_PROBE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/sequence.h"

typedef struct {
    probe_sample newest;     /* the last accepted pose; its session owns the probe */
    sequence order;          /* order of the owner's poses */
    int64_t received;        /* ns, monotonic: when the last accepted pose arrived */
    int64_t accepted, refused; /* since start */
} probe_arbiter;

void probe_arbiter_init(probe_arbiter *in);

/* Checks the bytes of a probe_pose_t that arrived at `now` (ns, monotonic). If they are valid, stores the pose in `newest` and returns true; otherwise writes
   the reason to `message` and returns false. The session that sends the first valid pose owns the probe until it has been silent for two seconds; the probe
   then stays where it is. Any speed is accepted, because no hand feels the probe's force. */
bool probe_arbiter_pose(probe_arbiter *in, const void *data, size_t size, int64_t now, char *message, size_t room);

#endif
