#include "view/stream/wire_format.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "shared/json.h"
#include "view/stream/model_faces.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "structs and arrays are sent without conversion");

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

static double number_of(const trocar_scene *s, const char *key) {
    double value = 0.0;
    trocar_scene_get_number(s, key, &value, NULL);
    return value;
}

/* An entry of one of the scene's lists: its name, its group in the mesh, and whether it is impenetrable. */
typedef struct {
    char name[64];
    int group;
    bool bone;
} list_entry;

static list_entry entry_of(const trocar_scene *s, const trocar_model *m, const char *list, int index, int dimension, const char *resistance) {
    list_entry entry = {.name = ""};
    char key[64];
    snprintf(key, sizeof key, "%s[%d].name", list, index);
    trocar_scene_get(s, key, entry.name, sizeof entry.name, NULL);
    entry.group = trocar_model_find_region(m, entry.name, dimension);
    snprintf(key, sizeof key, "%s[%d].%s", list, index, resistance);
    entry.bone = isinf(number_of(s, key));
    return entry;
}

static void write_regions(json *j, const trocar_scene *s, const trocar_model *m) {
    json_open(j, "regions", '[');
    for (int r = 0; r < trocar_scene_count(s, "regions"); r++) {
        list_entry region = entry_of(s, m, "regions", r, 3, "cutting_force");
        json_open(j, NULL, '{');
        json_text(j, "name", region.name);
        json_text(j, "organ", trocar_model_region_name(m, trocar_model_part_of(m, region.group)));
        json_integer(j, "group", region.group);
        json_number(j, "youngsModulus", trocar_model_material(m, region.group).youngs_modulus);
        json_bool(j, "bone", region.bone);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static void write_membranes(json *j, const trocar_scene *s, const trocar_model *m) {
    json_open(j, "membranes", '[');
    for (int i = 0; i < trocar_scene_count(s, "membranes"); i++) {
        list_entry membrane = entry_of(s, m, "membranes", i, 2, "puncture_force");
        json_open(j, NULL, '{');
        json_text(j, "name", membrane.name);
        json_integer(j, "group", membrane.group);
        json_bool(j, "bone", membrane.bone);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static void write_parking_poses(json *j, const pose *parking_poses, int needles) {
    json_open(j, "parkingPoses", '[');
    for (int i = 0; i < needles; i++) {
        json_open(j, NULL, '{');
        json_numbers(j, "position", &parking_poses[i].position.x, 3);
        json_numbers(j, "orientation", &parking_poses[i].orientation.w, 4);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static void write_guides(json *j, const trocar_model *m) {
    json_open(j, "guides", '[');
    for (int i = 0; i < trocar_model_guide_count(m); i++) {
        trocar_guide g = trocar_model_guide(m, i);
        json_open(j, NULL, '{');
        json_numbers(j, "origin", g.origin, 3);
        json_numbers(j, "normal", g.normal, 3);
        json_numbers(j, "alongColumns", g.across[0], 3);
        json_numbers(j, "alongRows", g.across[1], 3);
        json_integer(j, "columns", g.columns);
        json_integer(j, "rows", g.rows);
        json_number(j, "spacing", g.spacing);
        json_number(j, "holeDiameter", g.hole_diameter);
        json_number(j, "thickness", g.thickness);
        json_close(j, '}');
    }
    json_close(j, ']');
}

/* Writes the probe's shape, or nothing if the scene has no probe. */
static void write_probe(json *j, const trocar_model *m) {
    trocar_probe_shape shape;
    if (!trocar_model_probe(m, &shape)) return;
    json_open(j, "probe", '{');
    json_number(j, "radius", shape.radius);
    json_number(j, "tipRadius", shape.tip_radius);
    json_number(j, "length", shape.length);
    json_close(j, '}');
}

static void append_json(byte_buffer *b, const char *json, size_t length) {
    uint32_t count[2] = {(uint32_t)length, 0};
    bytes_append(b, count, sizeof count);
    size_t start = b->length;
    bytes_append(b, json, length);
    pad(b, start);
}

static void append_description(byte_buffer *b, const trocar_scene *s, const trocar_model *m, const pose *parking_poses, int needles, bool live) {
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    b->failed |= out == NULL;
    if (b->failed) return;
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_text(&j, "path", trocar_scene_path(s));
    json_bool(&j, "live", live);
    json_number(&j, "rate", trocar_model_rate(m));
    json_open(&j, "needle", '{');
    json_number(&j, "length", number_of(s, "needle.length"));
    json_number(&j, "diameter", number_of(s, "needle.outer_diameter"));
    json_close(&j, '}');
    write_parking_poses(&j, parking_poses, needles);
    double patient_to_mesh[16];
    if (trocar_model_patient_to_mesh(m, patient_to_mesh)) json_numbers(&j, "patientToMesh", patient_to_mesh, 16);
    json_number(&j, "seedLength", trocar_model_seed_size(m).length);
    json_number(&j, "seedSpacing", trocar_model_seed_size(m).spacing);
    write_regions(&j, s, m);
    write_membranes(&j, s, m);
    write_guides(&j, m);
    write_probe(&j, m);
    json_integer(&j, "nodes", trocar_model_node_count(m));
    json_integer(&j, "tets", trocar_model_tet_count(m));
    json_close(&j, '}');
    fclose(out);
    append_json(b, text, length);
    free(text);
}

static void append_nodes(byte_buffer *b, const trocar_model *m) {
    const double *nodes = trocar_model_nodes(m);
    for (int n = 0; n < trocar_model_node_count(m); n++) {
        float x[3] = {(float)nodes[3 * n], (float)nodes[3 * n + 1], (float)nodes[3 * n + 2]};
        bytes_append(b, x, sizeof x);
    }
}

static void append_tets(byte_buffer *b, const trocar_model *m) {
    const int32_t *tets = trocar_model_tets(m), *regions = trocar_model_tet_regions(m);
    for (int t = 0; t < trocar_model_tet_count(m); t++) {
        uint32_t tet[5] = {(uint32_t)regions[t]};
        for (int i = 0; i < 4; i++) tet[i + 1] = (uint32_t)tets[4 * t + i];
        bytes_append(b, tet, sizeof tet);
    }
}

/* Appends a triangle: three nodes (counter-clockwise as seen from outside `tet`), the groups of the regions inside and outside, and the bits of named
   surfaces. */
static void append_triangle(byte_buffer *b, const trocar_model *m, int tet, int face, int neighbour) {
    const int32_t *regions = trocar_model_tet_regions(m);
    uint32_t triangle[6];
    for (int i = 0; i < 3; i++) triangle[i] = (uint32_t)trocar_model_tets(m)[4 * tet + FACE_CORNERS[face][i]];
    triangle[3] = (uint32_t)regions[tet];
    triangle[4] = neighbour < 0 ? UINT32_MAX : (uint32_t)regions[neighbour];
    triangle[5] = trocar_model_face_surfaces(m)[4 * tet + face];
    bytes_append(b, triangle, sizeof triangle);
}

static void append_triangles(byte_buffer *b, const trocar_model *m) {
    for (int t = 0; t < trocar_model_tet_count(m); t++)
        for (int f = 0; f < 4; f++) {
            int n = trocar_model_neighbours(m)[4 * t + f];
            bool shown = face_bounds_region(m, t, f) || trocar_model_face_surfaces(m)[4 * t + f] != 0;
            if (shown && n < t) append_triangle(b, m, t, f, n);   /* send an interior triangle once, with the later of its two tetrahedra */
        }
}

void encode_scene(byte_buffer *out, const trocar_scene *scene, const trocar_model *model, const pose *parking_poses, int needles, bool live) {
    size_t begun = section_begin(out, SECTION_SCENE);
    append_description(out, scene, model, parking_poses, needles, live);
    append_nodes(out, model);
    append_tets(out, model);
    append_triangles(out, model);
    section_end(out, begun);
}

/* ---- pictures ---- */

/* A picture is its head, the probe if there is one, for each needle a head with its joints, contacts and tracks, and the displacements. */
typedef struct {
    double time, tick;
    float scale;
    uint32_t needles, nodes, probes; /* probes: 0 or 1 */
} picture_head;
_Static_assert(sizeof(picture_head) == 32, "decode.js reads 32 bytes");

typedef struct {
    double pose_ms;
    float orientation[4];
    uint32_t needle, joints, contacts, track_points;
    float tip_lead;
    uint32_t unused;
} needle_head;
_Static_assert(sizeof(needle_head) == 48, "decode.js: NEEDLE_BYTES");

/* The probe: pose of its base (w x y z), and force and torque on the hand, as in probe_wrench_t. */
typedef struct {
    float position[3], orientation[4], force[3], torque[3];
    uint32_t contacts, stopped, unused;
} sent_probe;
_Static_assert(sizeof(sent_probe) == 64, "decode.js: PROBE_BYTES");

static void append_probe(byte_buffer *b, const trocar_probe *p) {
    sent_probe sent = {.contacts = (uint32_t)p->contacts, .stopped = p->stopped != 0};
    for (int a = 0; a < 3; a++) {
        sent.position[a] = (float)p->base.position[a];
        sent.force[a] = (float)p->force[a];
        sent.torque[a] = (float)p->torque[a];
    }
    for (int a = 0; a < 4; a++) sent.orientation[a] = (float)p->base.orientation[a];
    bytes_append(b, &sent, sizeof sent);
}

/* Returns the displacement (m) that one count stands for. */
static float displacement_scale(const trocar_deformation_t *d) {
    float largest = 0;
    for (int n = 0; n < d->node_count; n++)
        for (int a = 0; a < 3; a++) largest = fmaxf(largest, fabsf(d->displacement[n][a]));
    return largest / INT16_MAX;
}

/* A point of a track: its position in the undeformed tissue and the tetrahedron that contains it, its track, and the membrane punctured there or -1. */
typedef struct {
    float position[3];
    int32_t tet, track, membrane;
} sent_point;
_Static_assert(sizeof(sent_point) == 24, "decode.js reads 24 bytes");

static void append_tracks(byte_buffer *b, const trocar_tracks_t *t) {
    for (int i = 0; i < t->point_count; i++) {
        const float *x = t->position[i];
        sent_point point = {{x[0], x[1], x[2]}, t->tet[i], t->track[i], t->membrane[i]};
        bytes_append(b, &point, sizeof point);
    }
}

static void append_needle(byte_buffer *b, const needle_shown *shown) {
    const trocar_contacts_t *c = shown->contacts;
    const double *q = c->orientation;
    needle_head head = {.pose_ms = 1e-3 * (double)c->pose_utime, .orientation = {(float)q[0], (float)q[1], (float)q[2], (float)q[3]},
                        .needle = (uint32_t)c->needle, .joints = (uint32_t)c->joint_count, .contacts = (uint32_t)c->contact_count,
                        .track_points = shown->tracks ? (uint32_t)shown->tracks->point_count : 0, .tip_lead = (float)c->tip_lead};
    bytes_append(b, &head, sizeof head);
    for (int j = 0; j < c->joint_count; j++) {
        float x[3] = {(float)c->centreline[j][0], (float)c->centreline[j][1], (float)c->centreline[j][2]};
        bytes_append(b, x, sizeof x);
    }
    for (int i = 0; i < c->contact_count; i++) {
        float contact[9] = {(float)c->position[i][0], (float)c->position[i][1], (float)c->position[i][2],
                            (float)c->force[i][0], (float)c->force[i][1], (float)c->force[i][2],
                            (float)c->arc[i], (float)c->state[i], (float)c->kind[i]};
        bytes_append(b, contact, sizeof contact);
    }
    if (shown->tracks) append_tracks(b, shown->tracks);
}

static void append_displacement(byte_buffer *b, const trocar_deformation_t *d, float scale) {
    for (int n = 0; n < d->node_count; n++) {
        int16_t counts[3] = {0};
        for (int a = 0; a < 3 && scale > 0; a++) counts[a] = (int16_t)lrintf(d->displacement[n][a] / scale);
        bytes_append(b, counts, sizeof counts);
    }
}

void encode_picture(byte_buffer *out, double time, const needle_shown needles[], int count, const trocar_probe *probe, const trocar_deformation_t *tissue) {
    picture_head head = {.time = time, .tick = (double)tissue->tick, .scale = displacement_scale(tissue), .nodes = (uint32_t)tissue->node_count,
                         .probes = probe && probe->placed};
    for (int i = 0; i < count; i++) head.needles += needles[i].contacts != NULL;
    size_t begun = section_begin(out, SECTION_PICTURE);
    bytes_append(out, &head, sizeof head);
    if (head.probes) append_probe(out, probe);
    for (int i = 0; i < count; i++)
        if (needles[i].contacts) append_needle(out, &needles[i]);
    append_displacement(out, tissue, head.scale);
    section_end(out, begun);
}

void encode_samples(byte_buffer *out, const plot_sample *samples, size_t count) {
    size_t begun = section_begin(out, SECTION_SAMPLES);
    bytes_append(out, samples, count * sizeof *samples);
    section_end(out, begun);
}

void encode_json(byte_buffer *out, section_kind kind, const char *json) {
    size_t begun = section_begin(out, kind);
    bytes_append(out, json, strlen(json));
    section_end(out, begun);
}

void encode_json_and_bytes(byte_buffer *out, section_kind kind, const char *json, size_t length, const void *bytes, size_t count) {
    size_t begun = section_begin(out, kind);
    append_json(out, json, length);
    bytes_append(out, bytes, count);
    section_end(out, begun);
}

/* ---- seeds ---- */

/* A seed: position and direction in the deformed tissue, then in the undeformed tissue; needle, guide, hole, and index in its strand. */
typedef struct {
    float places[4][3];
    int32_t numbers[4];
} sent_seed;
_Static_assert(sizeof(sent_seed) == 64, "decode.js reads 64 bytes a seed");

static sent_seed seed_of(const trocar_seeds_t *m, int i) {
    sent_seed s = {.numbers = {m->needle[i], m->guide[i], m->hole[i], m->strand[i]}};
    for (int a = 0; a < 3; a++) {
        s.places[0][a] = m->position[i][a];
        s.places[1][a] = m->direction[i][a];
        s.places[2][a] = m->rest_position[i][a];
        s.places[3][a] = m->rest_direction[i][a];
    }
    return s;
}

void encode_seeds(byte_buffer *out, const trocar_seeds_t *seeds) {
    size_t begun = section_begin(out, SECTION_SEEDS);
    int32_t counts[2] = {seeds->needle_count, seeds->seed_count};
    bytes_append(out, counts, sizeof counts);
    for (int i = 0; i < seeds->needle_count; i++) bytes_append(out, &(int32_t){seeds->pending[i]}, 4);
    for (int i = 0; i < seeds->seed_count; i++) {
        sent_seed s = seed_of(seeds, i);
        bytes_append(out, &s, sizeof s);
    }
    section_end(out, begun);
}
