#include "view/stream/timeline.h"

#include <stdlib.h>
#include <string.h>

trocar_status timeline_create(timeline *t, bool live, int needles, trocar_error *why) {
    *t = (timeline){.live = live, .picture_bytes_most = PICTURE_BYTES, .picture_stride = 1};
    for (int i = 0; i < needles; i++) t->gathered[i].membrane = -1;
    t->picture_room = live ? 1 : 1024;
    t->sample_room = (size_t)(needles * SAMPLE_SPAN / SAMPLE_SLOT);
    t->pictures = calloc(t->picture_room, sizeof *t->pictures);
    t->samples = calloc(t->sample_room, sizeof *t->samples);
    return t->pictures && t->samples ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the timeline");
}

void timeline_free(timeline *t) {
    for (size_t i = 0; t->pictures && i < t->picture_room; i++) bytes_free(&t->pictures[i]);
    free(t->pictures);
    free(t->samples);
    *t = (timeline){0};
}

/* Makes room for an entry. A log's arrays grow; in live mode, the oldest entry is overwritten. */
static trocar_status make_room(const timeline *t, int64_t count, void **array, size_t *room, size_t size, trocar_error *why) {
    if (t->live || (size_t)count < *room) return TROCAR_OK;
    void *wider = realloc(*array, 2 * *room * size);
    if (!wider) return fail(why, TROCAR_NO_MEMORY, "no memory for a log of %.0f s", t->now);
    memset((char *)wider + *room * size, 0, *room * size);
    *array = wider;
    *room *= 2;
    return TROCAR_OK;
}

static trocar_status close_slot(timeline *t, int needle, trocar_error *why) {
    void *array = t->samples;
    trocar_status status = make_room(t, t->sample_end, &array, &t->sample_room, sizeof *t->samples, why);
    t->samples = array;
    if (status != TROCAR_OK) return status;
    t->samples[(size_t)t->sample_end++ % t->sample_room] = t->gathered[needle];
    t->gathered[needle] = (plot_sample){.membrane = -1};
    return TROCAR_OK;
}

trocar_status timeline_add_sample(timeline *t, const plot_sample *s, trocar_error *why) {
    plot_sample *gathered = &t->gathered[s->needle];
    uint32_t events = gathered->events | s->events;
    int32_t membrane = s->membrane >= 0 ? s->membrane : gathered->membrane;
    t->now = s->time;
    *gathered = *s;
    gathered->events = events;
    gathered->membrane = membrane;
    if (s->time < t->slot_end[s->needle]) return TROCAR_OK;
    t->slot_end[s->needle] = s->time + 0.99 * SAMPLE_SLOT; /* slightly less than a slot, so that a tick at the end of a slot starts the next one */
    return close_slot(t, s->needle, why);
}

/* Removes every second picture. */
static void thin_out(timeline *t) {
    int64_t kept = 0;
    for (int64_t i = 0; i < t->picture_end; i++) {
        byte_buffer picture = t->pictures[i];
        t->pictures[i] = (byte_buffer){0};
        if (i % 2 == 0) t->pictures[kept++] = picture;
        else t->picture_bytes -= picture.room, bytes_free(&picture);
    }
    t->picture_end = kept;
    t->picture_stride *= 2;
}

/* Returns the slot for the next picture. In a log, that is the newest picture's slot, unless that picture must be kept. */
static byte_buffer *next_place(timeline *t) {
    if (!t->live && t->picture_end > 0 && (t->pictures_given - 1) % t->picture_stride != 0) t->picture_end--;
    if (!t->live && t->picture_bytes > t->picture_bytes_most && t->picture_end > 2) thin_out(t);
    t->pictures_given++;
    return &t->pictures[(size_t)t->picture_end++ % t->picture_room];
}

trocar_status timeline_add_picture(timeline *t, double time, const needle_shown needles[], int count,
                                   const trocar_probe *probe, const trocar_deformation_t *tissue, trocar_error *why) {
    void *array = t->pictures;
    trocar_status status = make_room(t, t->picture_end, &array, &t->picture_room, sizeof *t->pictures, why);
    t->pictures = array;
    if (status != TROCAR_OK) return status;
    byte_buffer *place = next_place(t);
    t->picture_bytes -= place->room;
    bytes_clear(place);
    encode_picture(place, time, needles, count, probe, tissue);
    t->picture_bytes += place->room;
    return place->failed ? fail(why, TROCAR_NO_MEMORY, "no memory for a picture") : TROCAR_OK;
}

trocar_status timeline_add_seeds(timeline *t, const trocar_seeds_t *seeds, trocar_error *why) {
    byte_buffer *newest = &t->pictures[(size_t)(t->picture_end - 1) % t->picture_room];
    t->picture_bytes -= newest->room;
    encode_seeds(newest, seeds);
    t->picture_bytes += newest->room;
    return newest->failed ? fail(why, TROCAR_NO_MEMORY, "no memory for a picture") : TROCAR_OK;
}

bool timeline_has_news(const timeline *t, const timeline_cursor *cursor) {
    return cursor->picture < t->picture_end || cursor->sample < t->sample_end;
}

static int64_t oldest_kept(int64_t end, size_t room) { return end > (int64_t)room ? end - (int64_t)room : 0; }

/* Copies samples up to the end of the ring. The next call copies the rest. */
static void read_samples(const timeline *t, timeline_cursor *cursor, byte_buffer *out) {
    int64_t oldest = oldest_kept(t->sample_end, t->sample_room);
    if (cursor->sample < oldest) cursor->sample = oldest;
    size_t first = (size_t)cursor->sample % t->sample_room, count = (size_t)(t->sample_end - cursor->sample);
    if (first + count > t->sample_room) count = t->sample_room - first;
    if (count > 0) encode_samples(out, t->samples + first, count);
    cursor->sample += (int64_t)count;
}

void timeline_read(const timeline *t, timeline_cursor *cursor, size_t most, byte_buffer *out) {
    read_samples(t, cursor, out);
    int64_t oldest = oldest_kept(t->picture_end, t->picture_room);
    if (cursor->picture < oldest) cursor->picture = oldest;
    for (; cursor->picture < t->picture_end && out->length < most; cursor->picture++) {
        const byte_buffer *encoded = &t->pictures[(size_t)cursor->picture % t->picture_room];
        bytes_append(out, encoded->data, encoded->length);
    }
}
