#include "wire_format.h"

#include <stdlib.h>
#include <string.h>

#include "json.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "structs and arrays are sent as they are");

/* ---- bytes ---- */

void bytes_append(byte_buffer *b, const void *data, size_t length) {
    if (b->failed || length == 0) return;
    if (length > b->room - b->length) {
        size_t room = 2 * (b->length + length);
        unsigned char *wider = room > length ? realloc(b->data, room) : NULL;
        b->failed = wider == NULL;
        if (b->failed) return;
        b->data = wider;
        b->room = room;
    }
    memcpy(b->data + b->length, data, length);
    b->length += length;
}

void bytes_clear(byte_buffer *b) {
    b->length = 0;
    b->failed = false;
}

void bytes_free(byte_buffer *b) {
    free(b->data);
    *b = (byte_buffer){0};
}

static void pad(byte_buffer *b, size_t start) {
    static const unsigned char zeros[8];
    bytes_append(b, zeros, (8 - (b->length - start) % 8) % 8);
}

size_t section_begin(byte_buffer *b, section_kind kind) {
    uint32_t head[2] = {kind, 0};
    bytes_append(b, head, sizeof head);
    return b->length;
}

void section_end(byte_buffer *b, size_t begun) {
    if (b->failed) return;
    uint32_t length = (uint32_t)(b->length - begun);
    memcpy(b->data + begun - sizeof length, &length, sizeof length);
    pad(b, begun);
}

/* ---- scene ---- */

static void write_regions(FILE *out, const scene *s, const mesh *m) {
    fprintf(out, "\"regions\":[");
    for (int r = 0; r < s->simulation.region_count; r++) {
        const region_config *region = &s->simulation.regions[r];
        fprintf(out, "%s{\"name\":", r ? "," : "");
        json_string(region->name, out);
        fprintf(out, ",\"group\":%d,\"youngsModulus\":%g,\"bone\":%s}", mesh_find_group(m, region->name, 3),
                region->material.youngs_modulus, isinf(region->material.cutting_force) ? "true" : "false");
    }
    fprintf(out, "],");
}

static void write_membranes(FILE *out, const scene *s, const mesh *m) {
    fprintf(out, "\"membranes\":[");
    for (int i = 0; i < s->simulation.membrane_count; i++) {
        fprintf(out, "%s{\"name\":", i ? "," : "");
        json_string(s->simulation.membranes[i].name, out);
        fprintf(out, ",\"group\":%d,\"bone\":%s}", mesh_find_group(m, s->simulation.membranes[i].name, 2),
                isinf(s->simulation.membranes[i].puncture_force) ? "true" : "false");
    }
    fprintf(out, "],");
}

static void append_description(byte_buffer *b, const scene *s, const mesh *m, pose home, bool live) {
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    b->failed |= out == NULL;
    if (b->failed) return;
    fprintf(out, "{\"path\":");
    json_string(s->path, out);
    fprintf(out, ",\"live\":%s,\"rate\":%g,\"needle\":{\"length\":%g,\"diameter\":%g},\"home\":[%g,%g,%g],", live ? "true" : "false",
            s->rate_hz, s->simulation.needle.length, s->simulation.needle.outer_diameter, home.position.x, home.position.y,
            home.position.z);
    write_regions(out, s, m);
    write_membranes(out, s, m);
    fprintf(out, "\"nodes\":%d,\"tets\":%d}", m->node_count, m->tet_count);
    fclose(out);
    uint32_t count[2] = {(uint32_t)length, 0};
    bytes_append(b, count, sizeof count);
    size_t start = b->length;
    bytes_append(b, text, length);
    pad(b, start);
    free(text);
}

static void append_nodes(byte_buffer *b, const mesh *m) {
    for (int n = 0; n < m->node_count; n++) {
        float x[3] = {(float)m->nodes[n].x, (float)m->nodes[n].y, (float)m->nodes[n].z};
        bytes_append(b, x, sizeof x);
    }
}

static void append_tets(byte_buffer *b, const mesh *m) {
    for (int t = 0; t < m->tet_count; t++) {
        uint32_t tet[5] = {(uint32_t)m->region[t]};
        for (int i = 0; i < 4; i++) tet[i + 1] = (uint32_t)m->tets[t][i];
        bytes_append(b, tet, sizeof tet);
    }
}

/* Three nodes (counter-clockwise from outside of `inner`), the groups of the regions behind and in front, bits of the
   named surfaces. */
static void append_triangle(byte_buffer *b, const mesh *m, int tet, int face, int neighbour) {
    static const int corners[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    uint32_t triangle[6];
    for (int i = 0; i < 3; i++) triangle[i] = (uint32_t)m->tets[tet][corners[face][i]];
    triangle[3] = (uint32_t)m->region[tet];
    triangle[4] = neighbour < 0 ? UINT32_MAX : (uint32_t)m->region[neighbour];
    triangle[5] = m->face_groups[tet][face];
    bytes_append(b, triangle, sizeof triangle);
}

static void append_triangles(byte_buffer *b, const mesh *m) {
    for (int t = 0; t < m->tet_count; t++)
        for (int f = 0; f < 4; f++) {
            int n = m->neighbours[t][f];
            bool shown = n < 0 || m->region[n] != m->region[t] || m->face_groups[t][f] != 0;
            if (shown && n < t) append_triangle(b, m, t, f, n);   /* an inner one is seen from both sides: the later tet's */
        }
}

void encode_scene(byte_buffer *out, const scene *s, const mesh *m, pose home, bool live) {
    size_t begun = section_begin(out, SECTION_SCENE);
    append_description(out, s, m, home, live);
    append_nodes(out, m);
    append_tets(out, m);
    append_triangles(out, m);
    section_end(out, begun);
}

/* ---- pictures ---- */

typedef struct {
    double time, tick, pose_ms;
    float orientation[4], scale;
    uint32_t joints, contacts, nodes;
    uint32_t unused[2];
} picture_head;
_Static_assert(sizeof(picture_head) == 64, "decode.js reads 64 bytes");

/* Metres that one count of a displacement stands for. */
static float displacement_scale(const trocar_deformation_t *d) {
    float largest = 0;
    for (int n = 0; n < d->node_count; n++)
        for (int a = 0; a < 3; a++) largest = fmaxf(largest, fabsf(d->displacement[n][a]));
    return largest / INT16_MAX;
}

static void append_contacts(byte_buffer *b, const trocar_contacts_t *c) {
    for (int j = 0; j < c->joint_count; j++) {
        float x[3] = {(float)c->centreline[j][0], (float)c->centreline[j][1], (float)c->centreline[j][2]};
        bytes_append(b, x, sizeof x);
    }
    for (int i = 0; i < c->contact_count; i++) {
        float contact[8] = {(float)c->position[i][0], (float)c->position[i][1], (float)c->position[i][2],
                            (float)c->force[i][0], (float)c->force[i][1], (float)c->force[i][2],
                            (float)c->arc[i], (float)c->state[i]};
        bytes_append(b, contact, sizeof contact);
    }
}

static void append_displacement(byte_buffer *b, const trocar_deformation_t *d, float scale) {
    for (int n = 0; n < d->node_count; n++) {
        int16_t counts[3] = {0};
        for (int a = 0; a < 3 && scale > 0; a++) counts[a] = (int16_t)lrintf(d->displacement[n][a] / scale);
        bytes_append(b, counts, sizeof counts);
    }
}

void encode_picture(byte_buffer *out, double time, const trocar_contacts_t *needle, const trocar_deformation_t *tissue) {
    const double *q = needle->orientation;
    picture_head head = {.time = time, .tick = (double)needle->tick, .pose_ms = 1e-3 * (double)needle->pose_utime,
                         .orientation = {(float)q[0], (float)q[1], (float)q[2], (float)q[3]}, .scale = displacement_scale(tissue),
                         .joints = (uint32_t)needle->joint_count, .contacts = (uint32_t)needle->contact_count,
                         .nodes = (uint32_t)tissue->node_count};
    size_t begun = section_begin(out, SECTION_PICTURE);
    bytes_append(out, &head, sizeof head);
    append_contacts(out, needle);
    append_displacement(out, tissue, head.scale);
    section_end(out, begun);
}

void encode_samples(byte_buffer *out, const plot_sample *samples, size_t count) {
    size_t begun = section_begin(out, SECTION_SAMPLES);
    bytes_append(out, samples, count * sizeof *samples);
    section_end(out, begun);
}

void encode_status(byte_buffer *out, const char *json) {
    size_t begun = section_begin(out, SECTION_STATUS);
    bytes_append(out, json, strlen(json));
    section_end(out, begun);
}
