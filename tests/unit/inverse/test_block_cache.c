/* Tests the block cache: symmetric access, and eviction of the least recently used blocks. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "inverse/block_cache.h"

#include <cmocka.h>

enum { NODES = 3 * BLOCK_CACHE_NODES, LD = 5 };

static void blocks_are_symmetric(void **state) {
    (void)state;
    block_cache c = {0};
    int rows[2] = {7, 2999}, columns[2] = {400, 7};
    double given[3 * LD], found[3 * LD];
    for (int i = 0; i < 3 * LD; i++) given[i] = i;
    assert_true(block_cache_create(&c, NODES));
    assert_true(block_cache_take(&c, 2, rows, 2, columns));
    assert_false(block_cache_knows(&c, 7, 400));
    block_cache_put(&c, 2999, 400, given, LD);
    assert_true(block_cache_knows(&c, 400, 2999) && block_cache_knows(&c, 2999, 400) && !block_cache_knows(&c, 7, 400));
    for (int turned = 0; turned < 2; turned++) {
        block_cache_get(&c, turned ? 400 : 2999, turned ? 2999 : 400, found, LD);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) assert_true(found[a * LD + b] == (turned ? given[b * LD + a] : given[a * LD + b]));
    }
    block_cache_free(&c);
}

static void least_recently_used_nodes_are_evicted(void **state) {
    (void)state;
    block_cache c = {0};
    static int many[NODES];
    double block[9] = {1, 2, 3, 4, 5, 6, 7, 8, 9};
    for (int i = 0; i < NODES; i++) many[i] = i;
    assert_true(block_cache_create(&c, NODES));
    assert_true(block_cache_take(&c, 3, many, 0, NULL));
    block_cache_put(&c, 0, 1, block, 3);
    block_cache_put(&c, 1, 2, block, 3);
    assert_true(block_cache_take(&c, BLOCK_CACHE_NODES - 3, many + 3, 0, NULL)); /* full */
    assert_true(block_cache_take(&c, 1, many + 2, 1, many + 1));                 /* uses nodes 2 and 1 again, leaving node 0 as the least recently used */
    assert_true(block_cache_take(&c, 1, many + BLOCK_CACHE_NODES, 0, NULL));
    assert_int_equal(c.nodes.slot[0], -1);
    assert_true(block_cache_knows(&c, 2, 1));
    assert_false(block_cache_knows(&c, BLOCK_CACHE_NODES, 1)); /* node 0's slot is reused, but its blocks are not */
    assert_true(block_cache_take(&c, 1, many, 0, NULL));
    assert_false(block_cache_knows(&c, 0, 1));
    assert_false(block_cache_take(&c, BLOCK_CACHE_NODES, many, 1, many));
    assert_true(block_cache_knows(&c, 2, 1));
    block_cache_free(&c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_are_symmetric),
        cmocka_unit_test(least_recently_used_nodes_are_evicted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
