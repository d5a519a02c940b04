/* The data for the browsers: encoded pictures, which are snapshots of needles and tissue, and samples for the plots. In live mode, keeps only the newest
   picture and the last minute of samples. For a log, keeps all samples, and all pictures up to a limit; beyond it, keeps every second picture, then every
   fourth, and so on, and always the newest. Not thread-safe. */
#ifndef TROCAR_TIMELINE_H
#define TROCAR_TIMELINE_H

#include "base/error.h"
#include "view/stream/wire_format.h"

#define SAMPLE_SLOT 0.01     /* s covered by one sample of a needle */
#define SAMPLE_SPAN 60.0     /* s of live samples that are kept */
#define PICTURE_BYTES ((size_t)256 << 20) /* bytes, most that a log's pictures may take up */

typedef struct {
    bool live;
    byte_buffer *pictures;   /* encoded; just one in live mode */
    int64_t picture_end;     /* number of the next picture */
    size_t picture_room;
    size_t picture_bytes, picture_bytes_most; /* bytes, size of the pictures, and the size beyond which pictures of a log are removed */
    int64_t pictures_given, picture_stride; /* pictures added so far; of a log, one in `picture_stride` is kept */
    plot_sample *samples;    /* of all needles, in chronological order; a ring buffer in live mode */
    int64_t sample_end;      /* number of the next sample */
    size_t sample_room;
    plot_sample gathered[TROCAR_MAX_NEEDLES]; /* accumulated in the current slot */
    double slot_end[TROCAR_MAX_NEEDLES];      /* s */
    double now;              /* s, time of the newest sample */
} timeline;

/* Creates a timeline for 1 to TROCAR_MAX_NEEDLES needles. Returns NO_MEMORY if out of memory. */
trocar_status timeline_create(timeline *t, bool live, int needles, trocar_error *why);
void timeline_free(timeline *t);

/* Adds the values of one tick of needle `s->needle`; `s` contains only that tick's events. For a log, returns NO_MEMORY if out of memory. */
trocar_status timeline_add_sample(timeline *t, const plot_sample *s, trocar_error *why);

/* Adds a picture; the arguments are those of encode_picture. Returns NO_MEMORY if out of memory. */
trocar_status timeline_add_picture(timeline *t, double time, const needle_shown needles[], int count,
                                   const trocar_probe *probe, const trocar_deformation_t *tissue, trocar_error *why);

/* Where a reader is: the numbers of the next picture and the next sample. */
typedef struct {
    int64_t picture, sample;
} timeline_cursor;

/* Adds the seeds that belong to the newest picture. Only for a log; in live mode, seeds are sent as a section of their own. */
trocar_status timeline_add_seeds(timeline *t, const trocar_seeds_t *seeds, trocar_error *why);

bool timeline_has_news(const timeline *t, const timeline_cursor *cursor);

/* Appends what is new to the reader, up to about `most` bytes: samples, then pictures (live: only the newest). */
void timeline_read(const timeline *t, timeline_cursor *cursor, size_t most, byte_buffer *out);

#endif
