/* Tests that a message is only accepted if it is complete and of the right type. Any other total length, array count or string length is refused. */
#include "common/message_fit.h"

#include <stdlib.h>
#include <string.h>

#include "trocar.h"
#include "trocar_command_reply_t.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "trocar_status_t.h"
#include "trocar_tracks_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { JOINTS = 31, CONTACTS = 2, NODES = 588 };

static unsigned char bytes[1 << 16];

static size_t pack_contacts(void) {
    static double joints[JOINTS][3], vectors[CONTACTS][3], *joint_rows[JOINTS], *vector_rows[CONTACTS], arcs[CONTACTS];
    static int8_t states[CONTACTS], kinds[CONTACTS];
    for (int i = 0; i < JOINTS; i++) joint_rows[i] = joints[i];
    for (int i = 0; i < CONTACTS; i++) vector_rows[i] = vectors[i];
    trocar_contacts_t m = {.joint_count = JOINTS, .centreline = joint_rows, .contact_count = CONTACTS, .position = vector_rows,
                           .force = vector_rows, .arc = arcs, .state = states, .kind = kinds};
    return (size_t)trocar_contacts_t_encode(bytes, 0, sizeof bytes, &m);
}

static void contacts_must_have_their_exact_size(void **unused) {
    (void)unused;
    size_t size = pack_contacts();
    assert_true(contacts_fit(bytes, size));
    for (size_t wrong = 0; wrong < 4096; wrong++) assert_true(wrong == size || !contacts_fit(bytes, wrong));
}

static void contacts_with_wrong_counts_are_rejected(void **unused) {
    (void)unused;
    size_t size = pack_contacts(), joint_count_at = 8 + 4 * 8 + 4 * 8 + 8 + 4;
    for (size_t byte = joint_count_at; byte < joint_count_at + 4; byte++)
        for (int value = 1; value < 256; value++) {
            bytes[byte] ^= (unsigned char)value;
            assert_false(contacts_fit(bytes, size));
            bytes[byte] ^= (unsigned char)value;
        }
}

static void tracks_must_have_their_exact_size_and_room(void **unused) {
    (void)unused;
    enum { POINTS = TROCAR_MAX_TRACK_POINTS + 1 };
    static float places[POINTS][3], *rows[POINTS];
    static int32_t tets[POINTS];
    static int16_t numbers[POINTS];
    static int8_t membranes[POINTS];
    for (int i = 0; i < POINTS; i++) rows[i] = places[i];
    trocar_tracks_t m = {.point_count = 3, .position = rows, .tet = tets, .track = numbers, .membrane = membranes};
    size_t size = (size_t)trocar_tracks_t_encode(bytes, 0, sizeof bytes, &m);
    for (size_t wrong = 0; wrong < 4096; wrong++) assert_true(tracks_fit(bytes, wrong) == (wrong == size));
    m.point_count = POINTS - 1;
    assert_true(tracks_fit(bytes, (size_t)trocar_tracks_t_encode(bytes, 0, sizeof bytes, &m)));
    m.point_count = POINTS;
    assert_false(tracks_fit(bytes, (size_t)trocar_tracks_t_encode(bytes, 0, sizeof bytes, &m)));
}

static void seeds_must_have_their_exact_size_and_room(void **unused) {
    (void)unused;
    enum { SEEDS = TROCAR_MAX_SEEDS + 1 };
    static float places[SEEDS][3], *rows[SEEDS];
    static int16_t numbers[SEEDS];
    for (int i = 0; i < SEEDS; i++) rows[i] = places[i];
    trocar_seeds_t m = {.needle_count = 2, .pending = numbers, .seed_count = 3, .position = rows, .direction = rows, .rest_position = rows, .rest_direction = rows,
                        .needle = numbers, .guide = numbers, .hole = numbers, .strand = numbers};
    size_t size = (size_t)trocar_seeds_t_encode(bytes, 0, sizeof bytes, &m);
    for (size_t wrong = 0; wrong < 4096; wrong++) assert_true(seeds_fit(bytes, wrong) == (wrong == size));
    for (int seeds = SEEDS - 1; seeds <= SEEDS; seeds++) {
        m.seed_count = seeds;
        assert_true(seeds_fit(bytes, (size_t)trocar_seeds_t_encode(bytes, 0, sizeof bytes, &m)) == (seeds < SEEDS));
    }
    m.seed_count = 0;
    m.needle_count = TROCAR_MAX_NEEDLES + 1;
    assert_false(seeds_fit(bytes, (size_t)trocar_seeds_t_encode(bytes, 0, sizeof bytes, &m)));
}

static void a_reply_must_be_terminated(void **unused) {
    (void)unused;
    trocar_command_reply_t m = {.message = "not in the tissue"};
    size_t size = (size_t)trocar_command_reply_t_encode(bytes, 0, sizeof bytes, &m);
    for (size_t wrong = 0; wrong < 4096; wrong++) assert_true(reply_fits(bytes, wrong) == (wrong == size));
    bytes[size - 1] = 'x';
    assert_false(reply_fits(bytes, size));
}

static void deformation_must_match_the_mesh(void **unused) {
    (void)unused;
    static float displacements[NODES][3], *rows[NODES];
    for (int i = 0; i < NODES; i++) rows[i] = displacements[i];
    trocar_deformation_t m = {.node_count = NODES, .displacement = rows};
    size_t size = (size_t)trocar_deformation_t_encode(bytes, 0, sizeof bytes, &m);
    assert_true(deformation_fits(bytes, size, NODES));
    assert_false(deformation_fits(bytes, size - 1, NODES) || deformation_fits(bytes, size, NODES + 1) || deformation_fits(bytes, 3, NODES));
}

/* LCM's own decoder would read past the end of an unterminated string. */
static void strings_must_be_terminated(void **unused) {
    (void)unused;
    trocar_status_t m = {.host = "lab", .scene = "a.yaml", .inverse = "", .message = "late"};
    size_t size = (size_t)trocar_status_t_encode(bytes, 0, sizeof bytes, &m);
    assert_true(status_fits(bytes, size));
    for (size_t wrong = 0; wrong < 4096; wrong++) assert_true(wrong == size || !status_fits(bytes, wrong));
    size_t strings_end = size - (3 * 4 + 8 + 4);
    bytes[strings_end - 1] = 'x';
    assert_false(status_fits(bytes, size));
    bytes[strings_end - 1] = 0;
    size_t scene_end = strings_end - (4 + sizeof "late") - (4 + sizeof "") - 1;
    assert_int_equal(bytes[scene_end], 0);
    bytes[scene_end] = 'x';
    assert_false(status_fits(bytes, size));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(contacts_must_have_their_exact_size),
        cmocka_unit_test(contacts_with_wrong_counts_are_rejected),
        cmocka_unit_test(tracks_must_have_their_exact_size_and_room),
        cmocka_unit_test(seeds_must_have_their_exact_size_and_room),
        cmocka_unit_test(a_reply_must_be_terminated),
        cmocka_unit_test(deformation_must_match_the_mesh),
        cmocka_unit_test(strings_must_be_terminated),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
