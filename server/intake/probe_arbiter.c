#include "intake/probe_arbiter.h"

#include <inttypes.h>
#include <stdio.h>

#include "common/messages.h"
#include "intake/safety_limits.h"
#include "trocar_probe_pose_t.h"

static const int64_t OWNER_SILENCE = 2000000000; /* ns after which another session may take over if the owner is silent */

void probe_arbiter_init(probe_arbiter *in) { *in = (probe_arbiter){.newest = {.seq = -1, .base.orientation.w = 1.0}}; }

/* Decodes a pose of the probe. The type has a fixed size, so decoding must use exactly the bytes received. */
static bool decode(const void *data, size_t size, trocar_probe_pose_t *m) {
    return size == (size_t)trocar_probe_pose_t_encoded_size(m) && trocar_probe_pose_t_decode(data, 0, (int)size, m) == (int)size;
}

/* Returns why the pose is refused, or NULL if it is not. */
static const char *fault_of(probe_arbiter *in, const trocar_probe_pose_t *m, const pose *base, int64_t now) {
    pose_verdict verdict = safety_check_pose(base);
    if (verdict == POSE_NOT_FINITE) return "not finite";
    if (verdict != POSE_ACCEPTED) return "quaternion not of unit length";
    if (m->session == 0) return "0 means nobody; choose another session number";
    bool owned = in->newest.session != 0 && now - in->received <= OWNER_SILENCE;
    if (owned && m->session != in->newest.session) return "another session holds the probe";
    return m->session == in->newest.session && !sequence_accepts(&in->order, m->seq) ? "out of order" : NULL;
}

bool probe_arbiter_pose(probe_arbiter *in, const void *data, size_t size, int64_t now, char *message, size_t room) {
    trocar_probe_pose_t m = {0};
    if (!decode(data, size, &m)) {
        in->refused++;
        snprintf(message, room, "probe's pose of %zu bytes refused: not a trocar.probe_pose_t of this version", size);
        return false;
    }
    pose base = load_pose(m.position, m.orientation);
    const char *fault = fault_of(in, &m, &base, now);
    if (fault) {
        in->refused++;
        snprintf(message, room, "probe's pose %" PRId64 " of session %" PRId64 " refused: %s", m.seq, m.session, fault);
        return false;
    }
    base.orientation = q_unit(base.orientation);
    in->newest = (probe_sample){.session = m.session, .seq = m.seq, .base = base};
    sequence_begin(&in->order, m.seq);
    in->received = now;
    in->accepted++;
    return true;
}
