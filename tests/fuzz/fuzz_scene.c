/* Reads a scene file. Either it is refused with a message that begins with the file's name, or every number is in its permitted range. */
#include "fuzz.h"

#include <string.h>

#include "scene/scene.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static scene s;
    trocar_error why = {""};
    const char *path = file_of(data, size);
    if (scene_load(path, &s, &why) != TROCAR_OK) {
        REQUIRE(strncmp(why.text, path, strlen(path)) == 0);
        return 0;
    }
    const simulation_config *c = &s.simulation;
    REQUIRE(s.rate_hz >= SCENE_MIN_RATE && s.rate_hz <= SCENE_MAX_RATE);
    REQUIRE(c->region_count >= 1 && c->region_count <= MAX_REGIONS && c->membrane_count >= 0 && c->membrane_count <= MAX_MEMBRANES);
    REQUIRE(c->fixed_count >= 1 && c->fixed_count <= MAX_FIXED);
    for (int i = 0; i < c->region_count; i++) {
        const region_material *m = &c->regions[i].material;
        REQUIRE(m->youngs_modulus > 0 && m->poisson_ratio >= 0 && m->poisson_ratio < 0.5 && m->cutting_force >= 0);
        REQUIRE(memchr(c->regions[i].name, 0, MESH_NAME) != NULL);
    }
    REQUIRE(c->needle.segments >= 2 && c->needle.segments <= NEEDLE_MAX_SEGMENTS && c->needle.length > c->needle.outer_diameter);
    REQUIRE(s.device.max_force > 0 && s.device.max_speed > 0 && s.device.ramp_time > 0);
    return 0;
}
