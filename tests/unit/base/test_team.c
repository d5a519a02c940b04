/* Tests a loop shared by threads: every index runs once, each member runs one index at a time, and all calls have returned by the time the loop returns. */
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/team.h"

#include <cmocka.h>

enum { MEMBERS = 4, MOST = 1000, ROUNDS = 2000 };

typedef struct {
    int calls[MOST];         /* not atomic on purpose, so that ThreadSanitizer detects calls that return late or are made twice */
    atomic_bool inside[MEMBERS];
    atomic_int wrong;
} loop;

static void note(void *context, int i, int member) {
    loop *l = context;
    if (member < 0 || member >= MEMBERS || atomic_exchange(&l->inside[member], true)) atomic_fetch_add(&l->wrong, 1);
    else {
        l->calls[i]++;
        atomic_store(&l->inside[member], false);
    }
}

static void each_index_is_taken_once(void **state) {
    (void)state;
    for (int members = 1; members <= MEMBERS; members++) {
        loop l = {.wrong = 0};
        int expected[MOST] = {0};
        team *t = team_create(members);
        assert_true((t == NULL) == (members == 1));
        assert_int_equal(team_members(t), members);
        for (int round = 0; round < ROUNDS; round++) {
            int count = round % 50 == 0 ? MOST : round % 5;
            team_run(t, count, note, &l);
            for (int i = 0; i < count; i++) expected[i]++;
            assert_memory_equal(l.calls, expected, sizeof expected);
        }
        assert_int_equal(l.wrong, 0);
        team_free(t);
    }
}

/* Two calls that wait for each other can only finish if two members run them concurrently. */
static atomic_int arrived;
static void meet(void *context, int i, int member) {
    (void)i;
    ((int *)context)[member]++;
    atomic_fetch_add(&arrived, 1);
    while (atomic_load(&arrived) < 2) continue;
}

static void members_work_at_the_same_time(void **state) {
    (void)state;
    int calls[2] = {0};
    team *t = team_create(2);
    team_run(t, 2, meet, calls);
    team_free(t);
    assert_int_equal(calls[0], 1);
    assert_int_equal(calls[1], 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(each_index_is_taken_once), cmocka_unit_test(members_work_at_the_same_time)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
