/* TROCAR_POSE, a stream of messages: eight bytes before each message give its length and time. Accepted poses must always be
   finite, have unit quaternions, respect the speed limits, be in order, and belong to one owner. */
#include "fuzz.h"

#include <string.h>

#include "pose_arbiter.h"
#include "scene/device.h"

static void check(const pose_arbiter *in, const pose_sample *before, pose_verdict verdict, int64_t now) {
    if (verdict != POSE_ACCEPTED) {
        REQUIRE(memcmp(before, &in->newest, sizeof *before) == 0);
        return;
    }
    const pose_sample *s = &in->newest;
    REQUIRE(s->held && s->session != 0 && s->session == in->record.owner && s->received == now);
    REQUIRE(safety_check_pose(&s->base) == POSE_ACCEPTED);
    REQUIRE(s->session != before->session || s->seq > before->seq);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    device_limits limits = device_defaults();
    pose_arbiter in;
    int64_t now = 1000000000, count = 0;
    arbiter_init(&in, &limits);
    while (size >= 8) {
        uint16_t length, later;
        memcpy(&length, data, 2);
        memcpy(&later, data + 2, 2);
        data += 8, size -= 8;
        if (length > size) length = (uint16_t)size;
        now += 1000 * (int64_t)later;
        pose_sample before = in.newest;
        check(&in, &before, arbiter_pose(&in, data, length, now), now);
        data += length, size -= length, count++;
    }
    for (int v = 0; v < POSE_VERDICTS; v++) count -= in.record.counts[v];
    REQUIRE(count == 0);
    return 0;
}
