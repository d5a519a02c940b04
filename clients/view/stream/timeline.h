/* Data for the browsers: encoded pictures, which are snapshots of needles and tissue, and samples for the plots. Of live data, only the newest picture
   and the last minute of samples are kept. Of a log, all samples are kept, and all pictures up to a limit; beyond it, every second picture is kept, then
   every fourth and so on, and always the newest. Not thread-safe. */
#ifndef TROCAR_TIMELINE_H
#define TROCAR_TIMELINE_H

#include "base/error.h"
#include "view/stream/wire_format.h"

#define SAMPLE_SLOT 0.01     /* s, time covered by one sample of a needle */
#define SAMPLE_SPAN 60.0     /* s, time span of the live samples that are kept */
#define PICTURE_BYTES ((size_t)256 << 20) /* bytes, maximum total size of a log's pictures */

typedef struct {
    bool live;
    byte_buffer *pictures;   /* encoded pictures; just one in live mode */
    int64_t picture_end;     /* number that the next picture will get */
    size_t picture_room;
    size_t picture_bytes, picture_bytes_most; /* bytes, size of the pictures; and the size above which pictures of a log are removed */
    int64_t pictures_given, picture_stride; /* number of pictures added so far; of a log, only one in `picture_stride` pictures is kept */
    plot_sample *samples;    /* samples of all needles, in chronological order; a ring buffer in live mode */
    int64_t sample_end;      /* number of the next sample */
    size_t sample_room;
    plot_sample gathered[TROCAR_MAX_NEEDLES]; /* values accumulated in the current time slot */
    double slot_end[TROCAR_MAX_NEEDLES];      /* s */
    double now;              /* s, time of the newest sample */
} timeline;

/* Creates a timeline for `needles` needles, 1 to TROCAR_MAX_NEEDLES. NO_MEMORY. */
trocar_status timeline_create(timeline *t, bool live, int needles, trocar_error *why);
void timeline_free(timeline *t);

/* Adds the values of one tick of needle `s->needle`; `s` contains the events of this tick only. NO_MEMORY (log only). */
trocar_status timeline_add_sample(timeline *t, const plot_sample *s, trocar_error *why);

/* Adds a picture, encoded by encode_picture with these arguments. NO_MEMORY. */
trocar_status timeline_add_picture(timeline *t, double time, const needle_shown needles[], int count,
                                   const trocar_probe *probe, const trocar_deformation_t *tissue, trocar_error *why);

/* Position of a reader: numbers of the next picture and sample. */
typedef struct {
    int64_t picture, sample;
} timeline_cursor;

/* Adds the seeds of the newest picture, after that picture. For a log only; in live mode, seeds are sent as a separate section. */
trocar_status timeline_add_seeds(timeline *t, const trocar_seeds_t *seeds, trocar_error *why);

bool timeline_has_news(const timeline *t, const timeline_cursor *cursor);

/* Appends the samples, then the pictures that are new to the reader (live: only the newest one), up to about `most` bytes. */
void timeline_read(const timeline *t, timeline_cursor *cursor, size_t most, byte_buffer *out);

#endif
