/* Checks the probe's poses before they are used: size, values, owner, order. No network, no clock, as in pose_arbiter.h. */
#ifndef TROCAR_PROBE_ARBITER_H
#define TROCAR_PROBE_ARBITER_H

#include <stddef.h>

#include "intake/requests.h"
#include "intake/sequence.h"

typedef struct {
    probe_sample newest;     /* last accepted pose, whose session owns the probe */
    sequence order;          /* order of that session's poses */
    int64_t received;        /* ns, monotonic: arrival of that pose */
    int64_t accepted, refused; /* since start */
} probe_arbiter;

void probe_arbiter_init(probe_arbiter *in);

/* Checks the bytes of a probe_pose_t that arrived at `now` (ns, monotonic). If they are valid, the pose becomes `newest` and the function returns
   true; otherwise `message` gives the reason. The session of the first valid pose owns the probe until it is silent for two seconds; a silent probe
   stays where it is. Any speed is accepted, because the probe's force is not rendered to a hand. */
bool probe_arbiter_pose(probe_arbiter *in, const void *data, size_t size, int64_t now, char *message, size_t room);

#endif
