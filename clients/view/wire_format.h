/* What a browser receives: sections of little-endian binary, each begun by its kind and its bytes (two u32) and padded to
   eight bytes, so that the page can lay typed arrays over them. page/src/decode.js is the other side. */
#ifndef TROCAR_WIRE_FORMAT_H
#define TROCAR_WIRE_FORMAT_H

#include "scene/scene.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"

/* A buffer that grows. When memory runs out, `failed` is set and nothing more is appended until it is cleared. */
typedef struct {
    unsigned char *data;
    size_t length, room;
    bool failed;
} byte_buffer;

void bytes_append(byte_buffer *b, const void *data, size_t length);
void bytes_clear(byte_buffer *b);  /* empty again, keeps its memory */
void bytes_free(byte_buffer *b);

typedef enum { SECTION_SCENE = 1, SECTION_PICTURE, SECTION_SAMPLES, SECTION_STATUS } section_kind;

/* Begin a section, append its bytes, end it. `begin` returns what `end` wants. */
size_t section_begin(byte_buffer *b, section_kind kind);
void section_end(byte_buffer *b, size_t begun);

/* One point of the plots: the newest values of a slot of time, all events in it. Sent as it is. */
typedef struct {
    double time;             /* s */
    float force[3];          /* N, world frame, as the device renders it */
    float torque[3];         /* N m */
    float depth;             /* m */
    float lateness_p99, lateness_max, compute_p99, compute_max; /* s, of the last interval of TROCAR_TIMING */
    uint32_t events;         /* insertion_event */
    int32_t membrane;        /* punctured in this slot, -1: none */
    uint32_t unused;
} plot_sample;
_Static_assert(sizeof(plot_sample) == 64, "decode.js reads 64 bytes a sample");

/* The scene as the page needs it: names and sizes as JSON, nodes, tetrahedra with their regions, and the triangles between
   regions, on the outer surface and on named surfaces. `live`: poses come from a server, not from a log. */
void encode_scene(byte_buffer *out, const scene *s, const mesh *m, pose home, bool live);

/* One picture at `time` (s): needle, contacts and the displacement of every node, rounded to 1/32767 of the largest
   component: of a millimetre to 30 nm. */
void encode_picture(byte_buffer *out, double time, const trocar_contacts_t *needle, const trocar_deformation_t *tissue);

void encode_samples(byte_buffer *out, const plot_sample *samples, size_t count);
void encode_status(byte_buffer *out, const char *json);

#endif
