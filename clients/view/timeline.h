/* What has happened, as the browsers are told: encoded pictures and samples for the plots. Live, only the newest picture and
   the last minute of samples are kept. Of a log all samples are, and all pictures while they have room, then every second,
   every fourth and so on, always with the newest. One thread. */
#ifndef TROCAR_TIMELINE_H
#define TROCAR_TIMELINE_H

#include "wire_format.h"

#define SAMPLE_SLOT 0.01     /* s of ticks that one sample stands for */
#define SAMPLE_SPAN 60.0     /* s of samples that are kept live */
#define PICTURE_BYTES ((size_t)256 << 20) /* that the pictures of a log may take */

typedef struct {
    bool live;
    byte_buffer *pictures;   /* encoded; live: one */
    int64_t picture_end;     /* number of the next picture */
    size_t picture_room;
    size_t picture_bytes, picture_bytes_most; /* taken, and when pictures of a log are thinned out */
    int64_t pictures_given, picture_stride; /* of a log: one in so many is kept */
    plot_sample *samples;    /* live: a ring */
    int64_t sample_end;      /* number of the next sample */
    size_t sample_room;
    plot_sample gathered;    /* of the slot that is being filled */
    double slot_end;         /* s */
    double now;              /* s, newest time known */
} timeline;

trocar_status timeline_create(timeline *t, bool live, report *why);
void timeline_free(timeline *t);

/* Takes one tick's values: `s` with the events of this tick only. NO_MEMORY, of a log only. */
trocar_status timeline_add_sample(timeline *t, const plot_sample *s, report *why);
trocar_status timeline_add_picture(timeline *t, double time, const trocar_contacts_t *needle, const trocar_deformation_t *tissue,
                                   report *why);

/* Where a reader is: numbers of the next picture and sample that it has not got. */
typedef struct {
    int64_t picture, sample;
} timeline_cursor;

bool timeline_has_news(const timeline *t, const timeline_cursor *cursor);

/* Appends what is new to the reader: samples, then pictures, all that are kept (the newest one, live), up to about
   `most` bytes. */
void timeline_read(const timeline *t, timeline_cursor *cursor, size_t most, byte_buffer *out);

#endif
