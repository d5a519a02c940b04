/* Processes a stream of TROCAR_POSE messages. The eight bytes before each give its length and time. Accepted poses must always be finite, have unit
   quaternions, respect the speed limits, be in order, and come from only one owner per needle. */
#include "fuzz.h"

#include <string.h>

#include "intake/pose_arbiter.h"
#include "scene/device.h"

enum { NEEDLES = 2 };

/* Returns the needle whose pose was accepted, or -1. `refused`: poses refused since each needle's last accepted one. */
static int check(const pose_arbiter *in, const arbiter_needle before[NEEDLES], pose_verdict verdict, int64_t now, const int refused[NEEDLES]) {
    int changed = -1;
    for (int i = 0; i < NEEDLES; i++) {
        const pose_sample *s = &in->needles[i].newest, *b = &before[i].newest;
        if (memcmp(s, b, sizeof *b) == 0) continue;
        if (!s->held) { /* the owner has moved on to another needle */
            REQUIRE(verdict == POSE_ACCEPTED && in->record.needles[i].owner == 0);
            continue;
        }
        REQUIRE(changed < 0 && verdict == POSE_ACCEPTED && s->session != 0 && s->session == in->record.needles[i].owner && s->received == now);
        REQUIRE(safety_check_pose(&s->base) == POSE_ACCEPTED);
        REQUIRE(s->session != b->session || s->seq > b->seq || refused[i] >= SEQUENCE_RUN - 1); /* a sender may restart its numbering */
        REQUIRE(in->record.needles[1 - i].owner != s->session);
        changed = i;
    }
    REQUIRE((verdict == POSE_ACCEPTED) == (changed >= 0));
    return changed;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    device_limits limits = device_defaults();
    pose_arbiter in;
    int64_t now = 1000000000, count = 0;
    int refused[NEEDLES] = {0};
    arbiter_init(&in, NEEDLES, &limits);
    while (size >= 8) {
        uint16_t length, later;
        memcpy(&length, data, 2);
        memcpy(&later, data + 2, 2);
        data += 8, size -= 8;
        if (length > size) length = (uint16_t)size;
        now += 1000 * (int64_t)later;
        arbiter_needle before[NEEDLES];
        memcpy(before, in.needles, sizeof before);
        pose_verdict verdict = arbiter_pose(&in, data, length, now);
        int accepted = check(&in, before, verdict, now, refused);
        for (int i = 0; i < NEEDLES; i++) refused[i] = i == accepted ? 0 : refused[i] + (accepted < 0);
        data += length, size -= length, count++;
    }
    count -= in.record.poses_malformed + in.record.poses_no_needle;
    for (int i = 0; i < NEEDLES; i++)
        for (int v = 0; v < POSE_VERDICTS; v++) count -= in.record.needles[i].counts[v];
    REQUIRE(count == 0);
    return 0;
}
