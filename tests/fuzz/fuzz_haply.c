/* Parses the input as a message from the Haply Inverse Service, and as one of its events. The first byte selects which device and handle are requested. */
#include "fuzz.h"

#include <string.h>

#include "message.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const haply_choice choices[] = {{.clutch = "a"}, {.device = "049D", .clutch = "b"}, {.handle = "61548", .clutch = "button_0"}};
    haply_state state;
    char text[1024], told[64];
    if (size == 0) return 0;
    const haply_choice *choice = &choices[data[0] % 3];
    haply_problem problem = haply_read((const char *)data + 1, size - 1, choice, &state);
    REQUIRE(state.device[HAPLY_ID - 1] == '\0' && state.handle[HAPLY_ID - 1] == '\0');
    if (problem == HAPLY_GOOD) {
        const quat *q = &state.orientation;
        REQUIRE(v3_norm(state.position) <= 1.0);
        REQUIRE(fabs(q->w * q->w + q->x * q->x + q->y * q->y + q->z * q->z - 1) < 1e-9);
        REQUIRE(choice->device[0] ? strcmp(state.device, choice->device) == 0 : state.device[0] != '\0');
        /* If the device's id is requested, the message can still be read and gives the same id. */
        haply_state again;
        size_t length = haply_write_force(text, sizeof text, state.device, "vector", v3(-1e3, 1e3, 1e3), true);
        REQUIRE(length == strlen(text) && length < sizeof text);
        REQUIRE(haply_read(text, length, choice, &again) == HAPLY_BAD_POSITION && strcmp(again.device, state.device) == 0);
    }
    if (haply_read_event((const char *)data + 1, size - 1, told, sizeof told)) REQUIRE(strlen(told) < sizeof told);
    return 0;
}
