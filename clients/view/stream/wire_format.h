/* Binary format of the messages to browsers, which page/src/decode.js reads. A message consists of little-endian sections. A section has a header with its kind
   and size (two u32), and is padded to eight bytes so that the page can use typed arrays. */
#ifndef TROCAR_WIRE_FORMAT_H
#define TROCAR_WIRE_FORMAT_H

#include <stdbool.h>
#include <stddef.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "trocar_tracks_t.h"

/* A growing buffer. If out of memory, `failed` is set and nothing is appended until the buffer is cleared. */
typedef struct {
    unsigned char *data;
    size_t length, room;
    bool failed;
} byte_buffer;

void bytes_append(byte_buffer *b, const void *data, size_t length);
void bytes_clear(byte_buffer *b);  /* empties the buffer but keeps its memory */
void bytes_free(byte_buffer *b);

typedef enum { SECTION_SCENE = 1, SECTION_PICTURE, SECTION_SAMPLES, SECTION_STATUS, SECTION_SEEDS, SECTION_REPLY, SECTION_DOSE,
               SECTION_PLAN, SECTION_ULTRASOUND } section_kind;

/* To write a section, begin it, append its bytes and end it. Pass to section_end what section_begin returned. */
size_t section_begin(byte_buffer *b, section_kind kind);
void section_end(byte_buffer *b, size_t begun);

/* A sample for the plots of a needle: the newest values in a time slot, and all its events. Sent as it is. */
typedef struct {
    double time;             /* s */
    float force[3];          /* N, world frame, as sent to the device */
    float torque[3];         /* N m */
    float depth;             /* m */
    float lateness_p99, lateness_max, compute_p99, compute_max; /* s, over the last interval of TROCAR_TIMING */
    uint32_t events;         /* TROCAR_EVENT_ bits */
    int32_t membrane;        /* punctured in this slot; -1 if none */
    int32_t needle;
} plot_sample;
_Static_assert(sizeof(plot_sample) == 64, "decode.js reads 64 bytes a sample");

/* Encodes the scene for the page: names and sizes as JSON, nodes, tetrahedra with their regions, and the triangles between regions, on the outer surface and on
   named surfaces. `parking_poses` are the waiting poses of the needles. `live` is true if the data come from a server, false if from a log. */
void encode_scene(byte_buffer *out, const trocar_scene *scene, const trocar_model *model, const pose *parking_poses, int needles, bool live);

/* A needle in a picture. Both pointers are NULL if it has not been held yet. */
typedef struct {
    const trocar_contacts_t *contacts;
    const trocar_tracks_t *tracks; /* newest tracks; NULL before the first message */
} needle_shown;

/* Encodes a picture, which is the state at `time` (s): each needle with its contacts and tracks, the probe if it has been placed (`probe` may be NULL), and the
   displacements of all nodes, rounded to 1/32767 of the largest component (30 nm per millimetre). */
void encode_picture(byte_buffer *out, double time, const needle_shown needles[], int count, const trocar_probe *probe, const trocar_deformation_t *tissue);

void encode_samples(byte_buffer *out, const plot_sample *samples, size_t count);

/* Encodes a section of JSON alone: STATUS, REPLY, PLAN. */
void encode_json(byte_buffer *out, section_kind kind, const char *json);

/* Encodes a section of JSON, padding and bytes: DOSE, ULTRASOUND. */
void encode_json_and_bytes(byte_buffer *out, section_kind kind, const char *json, size_t length, const void *bytes, size_t count);

void encode_seeds(byte_buffer *out, const trocar_seeds_t *seeds);

#endif
