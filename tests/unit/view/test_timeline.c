/* Tests what a reader of the timeline gets: live, the newest snapshot and each stored sample once; when playing a log, all snapshots, or as many as can be
   stored. */
#include "view/stream/timeline.h"

#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

typedef struct { int pictures, samples; double last_picture, last_sample; } seen;

/* Parses the sections as the web page does. */
static seen take(const byte_buffer *b) {
    seen s = {0};
    for (size_t at = 0; at < b->length;) {
        uint32_t head[2];
        memcpy(head, b->data + at, sizeof head);
        if (head[0] == SECTION_PICTURE) {
            s.pictures++;
            memcpy(&s.last_picture, b->data + at + 8, sizeof(double));
        } else {
            assert_int_equal(head[0], SECTION_SAMPLES);
            s.samples += (int)(head[1] / sizeof(plot_sample));
            memcpy(&s.last_sample, b->data + at + 8 + head[1] - sizeof(plot_sample), sizeof(double));
        }
        at += 8 + (head[1] + 7) / 8 * 8;
        assert_true(at <= b->length);
    }
    return s;
}

static seen read_once(const timeline *t, timeline_cursor *cursor) {
    byte_buffer out = {0};
    timeline_read(t, cursor, 1 << 20, &out);
    seen s = take(&out);
    bytes_free(&out);
    return s;
}

static void play(timeline *t, int from, int to) {
    trocar_error why;
    trocar_contacts_t needle = {.orientation = {1, 0, 0, 0}};
    trocar_deformation_t tissue = {0};
    for (int ms = from; ms < to; ms++) {
        plot_sample s = {.time = 1e-3 * ms, .depth = (float)ms, .membrane = ms == from + 5 ? 1 : -1, .events = ms == from + 5 ? 2 : 0};
        assert_int_equal(timeline_add_sample(t, &s, &why), TROCAR_OK);
        if (ms % 33 == 0) assert_int_equal(timeline_add_picture(t, s.time, (const needle_shown[]){{&needle, NULL}}, 1, NULL, &tissue, &why), TROCAR_OK);
    }
}

static void live_readers_get_the_newest_picture(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, true, 1, &why), TROCAR_OK);
    timeline_cursor quick = {0}, slow = {0};
    assert_false(timeline_has_news(&t, &quick));
    play(&t, 0, 1000);
    seen s = read_once(&t, &quick);
    assert_true(s.pictures == 1 && s.samples >= 99 && s.samples <= 101);
    assert_close(s.last_picture, 0.99, 1e-9);
    assert_false(timeline_has_news(&t, &quick));
    play(&t, 1000, 2000);
    s = read_once(&t, &quick);
    assert_true(s.pictures == 1 && s.samples >= 99 && s.samples <= 101);
    s = read_once(&t, &slow);
    assert_true(s.pictures == 1 && s.samples >= 199 && s.samples <= 201); /* the plots have no gaps */
    timeline_free(&t);
}

/* The ring buffer discards the oldest samples. A late reader gets the rest in order. */
static void the_last_minute_is_kept(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, true, 1, &why), TROCAR_OK);
    play(&t, 0, 90000);
    timeline_cursor late = {0};
    int samples = 0;
    double last = 0;
    while (timeline_has_news(&t, &late)) {
        seen s = read_once(&t, &late);
        assert_true(s.samples == 0 || s.last_sample > last);
        if (s.samples) last = s.last_sample;
        samples += s.samples;
    }
    assert_int_equal(samples, 6000);
    assert_close(last, 90, 0.02);
    timeline_free(&t);
}

static void a_slot_keeps_all_its_events(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    play(&t, 0, 30); /* the puncture is in the tick at 5 ms, between two samples */
    int found = 0;
    for (int64_t i = 0; i < t.sample_end; i++) found += t.samples[i].events == 2 && t.samples[i].membrane == 1;
    assert_int_equal(found, 1);
    timeline_free(&t);
}

static void log_is_read_completely_in_parts(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    play(&t, 0, 100000);
    timeline_cursor cursor = {0};
    int pictures = 0, samples = 0, pieces = 0;
    for (; timeline_has_news(&t, &cursor); pieces++) {
        byte_buffer out = {0};
        timeline_read(&t, &cursor, 4096, &out);
        seen s = take(&out);
        bytes_free(&out);
        pictures += s.pictures;
        samples += s.samples;
    }
    assert_int_equal(pictures, (100000 + 32) / 33);
    assert_true(samples >= 9990 && samples <= 10010);
    assert_true(pieces > 10);
    timeline_free(&t);
}

/* A log that does not fit into the storage is thinned out evenly: its beginning is kept, and the newest snapshot is always available. */
static void a_long_log_keeps_its_beginning(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
    play(&t, 0, 30);
    size_t one = t.pictures[0].room;
    timeline_free(&t);
    for (int end = 3300; end <= 3300 + 8 * 33; end += 33) { /* more than 100 snapshots, of which 30 can be stored */
        assert_int_equal(timeline_create(&t, false, 1, &why), TROCAR_OK);
        t.picture_bytes_most = 30 * one;
        play(&t, 0, end);
        assert_true(t.picture_end >= 15 && t.picture_end <= 31);
        double time[32];
        for (int i = 0; i < t.picture_end; i++) memcpy(&time[i], t.pictures[i].data + 8, sizeof time[i]);
        assert_close(time[0], 0, 0);
        assert_close(time[t.picture_end - 1], 1e-3 * (end - 33), 1e-9);
        for (int i = 1; i < t.picture_end - 1; i++) assert_close(time[i], 0.033 * 4 * i, 1e-9);
        timeline_free(&t);
    }
}

/* One needle's events and values do not show up in another's slots. */
static void needles_have_slots_of_their_own(void **unused) {
    (void)unused;
    timeline t;
    trocar_error why;
    assert_int_equal(timeline_create(&t, true, 2, &why), TROCAR_OK);
    for (int ms = 0; ms < 1000; ms++)
        for (int needle = 0; needle < 2; needle++) {
            bool event = needle == 1 && ms == 555;
            plot_sample s = {.time = 1e-3 * ms, .depth = (float)needle, .membrane = event ? 3 : -1, .events = event ? 2 : 0, .needle = needle};
            assert_int_equal(timeline_add_sample(&t, &s, &why), TROCAR_OK);
        }
    int counts[2] = {0}, events[2] = {0};
    for (int64_t i = 0; i < t.sample_end; i++) {
        const plot_sample *s = &t.samples[i];
        assert_true(s->depth == (float)s->needle);
        counts[s->needle]++;
        events[s->needle] += s->events == 2 && s->membrane == 3;
    }
    assert_in_range(counts[0], 99, 101);
    assert_int_equal(counts[1], counts[0]);
    assert_true(events[0] == 0 && events[1] == 1);
    assert_true(t.sample_room >= 2 * (size_t)(SAMPLE_SPAN / SAMPLE_SLOT)); /* room for one minute of samples of both needles */
    timeline_free(&t);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(needles_have_slots_of_their_own),
        cmocka_unit_test(live_readers_get_the_newest_picture),
        cmocka_unit_test(the_last_minute_is_kept),
        cmocka_unit_test(a_slot_keeps_all_its_events),
        cmocka_unit_test(log_is_read_completely_in_parts),
        cmocka_unit_test(a_long_log_keeps_its_beginning),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
