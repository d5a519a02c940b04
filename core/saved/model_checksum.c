#include "saved/model_checksum.h"

#include <string.h>

#include "base/hash.h"
#include "scene/scene_table.h"
#include "scene/scene_value.h"

uint64_t mesh_checksum(const model_parts *parts) {
    const mesh *m = &parts->mesh;
    uint64_t h = mesh_hash(HASH_BASIS, m);
    h = hash_bytes(h, m->face_groups, (size_t)m->tet_count * sizeof *m->face_groups);
    for (int g = 0; g < m->group_count; g++) h = hash_bytes(h, m->groups[g].name, strlen(m->groups[g].name) + 1);
    return parts->tissue.dof ? hash_bytes(h, parts->tissue.dof, (size_t)m->node_count * sizeof *parts->tissue.dof) : h;
}

/* Returns whether the checksum includes this key: it must describe the simulation and not be a path, which says nothing about the contents of the file. */
static bool counts(const key_spec *key) {
    bool path = key->kind == FILE_PATH || key->kind == DIRECTORY_PATH;
    bool simulated = key->list != NO_LIST || (key->offset >= offsetof(scene, simulation) && key->offset < offsetof(scene, simulation) + sizeof(simulation_config));
    return simulated && !path;
}

static uint64_t add_value(uint64_t h, const scene *s, const key_spec *key, const void *base) {
    char text[8192];
    int length = print_value(s, key, base, text, sizeof text);
    h = hash_bytes(h, key->key, strlen(key->key) + 1);
    return hash_bytes(h, text, length < 0 ? 0 : (size_t)length < sizeof text ? (size_t)length : sizeof text);
}

uint64_t model_checksum(uint64_t mesh, const scene *s, const model_parts *parts) {
    uint64_t h = hash_bytes(HASH_BASIS, &mesh, sizeof mesh);
    h = hash_bytes(h, &parts->config.insertion.most_steps, sizeof parts->config.insertion.most_steps);
    if (parts->inverse) h = hash_bytes(h, inverse_name(parts->inverse), strlen(inverse_name(parts->inverse)));
    for (int row = 0; row < SCENE_ROWS; row++) {
        const key_spec *key = &SCENE_TABLE[row];
        int entries = key->list == NO_LIST ? 1 : *count_of((scene *)s, key->list);
        for (int i = 0; i < entries && counts(key); i++) h = add_value(h, s, key, key->list == NO_LIST ? s : entry_of((scene *)s, key->list, i));
    }
    return h;
}
