/* Decodes messages to monitors and viewers. The first byte selects the type. LCM must decode every message of the right size completely and without leaks. */
#include "fuzz.h"

#include <string.h>

#include "common/message_fit.h"
#include "trocar_command_reply_t.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "trocar_status_t.h"

enum { NODES = 5 };

static void try_contacts(const uint8_t *data, size_t size) {
    trocar_contacts_t m;
    if (!contacts_fit(data, size)) return;
    if (trocar_contacts_t_decode(data, 0, (int)size, &m) < 0) return; /* another fingerprint */
    REQUIRE(trocar_contacts_t_encoded_size(&m) == (int)size);
    trocar_contacts_t_decode_cleanup(&m);
}

static void try_deformation(const uint8_t *data, size_t size) {
    trocar_deformation_t m;
    if (!deformation_fits(data, size, NODES)) return;
    if (trocar_deformation_t_decode(data, 0, (int)size, &m) < 0) return;
    REQUIRE(m.node_count == NODES);
    trocar_deformation_t_decode_cleanup(&m);
}

static void try_status(const uint8_t *data, size_t size) {
    trocar_status_t m;
    if (!status_fits(data, size)) return;
    if (trocar_status_t_decode(data, 0, (int)size, &m) < 0) return;
    REQUIRE(strlen(m.host) < size && strlen(m.scene) < size && strlen(m.inverse) < size && strlen(m.message) < size);
    trocar_status_t_decode_cleanup(&m);
}

static void try_seeds(const uint8_t *data, size_t size) {
    trocar_seeds_t m;
    if (!seeds_fit(data, size)) return;
    if (trocar_seeds_t_decode(data, 0, (int)size, &m) < 0) return;
    REQUIRE(trocar_seeds_t_encoded_size(&m) == (int)size);
    trocar_seeds_t_decode_cleanup(&m);
}

static void try_reply(const uint8_t *data, size_t size) {
    trocar_command_reply_t m;
    if (!reply_fits(data, size)) return;
    if (trocar_command_reply_t_decode(data, 0, (int)size, &m) < 0) return;
    REQUIRE(strlen(m.message) < size);
    trocar_command_reply_t_decode_cleanup(&m);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static void (*const types[])(const uint8_t *, size_t) = {try_contacts, try_deformation, try_status, try_seeds, try_reply};
    if (size > 0) types[data[0] % 5](data + 1, size - 1);
    return 0;
}
