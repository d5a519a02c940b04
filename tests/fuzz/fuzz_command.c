/* Sends a TROCAR_COMMAND to an arbiter whose needle has an owner. The first byte selects whether the owner sends it, and whether it comes from another
   machine. */
#include "fuzz.h"

#include "intake/pose_arbiter.h"
#include "scene/device.h"
#include "trocar_command_t.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    device_limits limits = device_defaults();
    pose_arbiter in;
    arbiter_init(&in, 2, &limits);
    if (size == 0) return 0;
    in.record.needles[0].owner = data[0] % 2 ? 1 : 0;
    trocar_command_t m;
    needle_command decoded;
    command_verdict verdict = arbiter_command(&in, data + 1, size - 1, data[0] & 2, 0, &decoded);
    bool shutdown = verdict == COMMAND_SHUTDOWN;
    bool whole = trocar_command_t_decode(data + 1, 0, (int)size - 1, &m) == (int)size - 1;
    REQUIRE(whole || (verdict == COMMAND_MALFORMED && in.record.commands_refused == 1 && in.record.needles[0].owner == data[0] % 2));
    REQUIRE(verdict != COMMAND_PASS_ON || m.command == TROCAR_COMMAND_T_RESET || m.command == TROCAR_COMMAND_T_CLEAR || (m.command >= TROCAR_COMMAND_T_LEAVE && m.command <= TROCAR_COMMAND_T_UNDO));
    REQUIRE(!shutdown || (m.command == TROCAR_COMMAND_T_SHUTDOWN && (!(data[0] & 2) || (in.record.needles[0].owner != 0 && m.session == in.record.needles[0].owner))));
    return 0;
}
