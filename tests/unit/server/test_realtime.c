/* Tests that each of realtime.c's requests to Linux takes effect, or that the error message says which limit to raise. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <float.h>
#include <pthread.h>
#include <stdbool.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "common/realtime.h"
#include "common/timing.h"
#include "privileges.h"
#include "sanitized.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void *underflow(void *flush) {
    static double result[2];
    if (flush != NULL) realtime_flush_denormals();
    volatile double tiny = DBL_MIN, half = 0.5;
    int index = flush != NULL;
    result[index] = tiny * half;
    return &result[index];
}

static double in_a_thread(void *flush) {
    pthread_t thread;
    void *result;
    pthread_create(&thread, NULL, underflow, flush);
    pthread_join(thread, &result);
    return *(double *)result;
}

static void denormals_become_zero(void **unused) {
    (void)unused;
    assert_true(in_a_thread(NULL) > 0.0);
    assert_true(in_a_thread("flush") == 0.0);
}

__attribute__((noinline)) static void use_stack(void) {
    unsigned char deep[REALTIME_STACK_TOUCHED - 65536];
    memset(deep, 1, sizeof deep);
    __asm__ volatile("" : : "r"(deep) : "memory");
}

static void *faults_on_a_touched_stack(void *faults) {
    realtime_touch_stack();
    int64_t before = thread_usage_now().minor_faults;
    use_stack();
    *(int64_t *)faults = thread_usage_now().minor_faults - before;
    return NULL;
}

static void a_touched_stack_does_not_fault(void **unused) {
    (void)unused;
#if defined(__SANITIZE_ADDRESS__)
    skip(); /* AddressSanitizer moves large local variables off the stack, so stack use cannot be measured */
#endif
    int64_t faults = -1;
    pthread_t thread;
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, REALTIME_STACK);
    assert_int_equal(pthread_create(&thread, &attributes, faults_on_a_touched_stack, &faults), 0);
    pthread_join(thread, NULL);
    pthread_attr_destroy(&attributes);
    assert_int_equal(faults, 0);
}

static void *set_priority(void *policy) {
    trocar_error why = {""};
    struct sched_param p;
    bool granted = realtime_set_priority(PRIORITY_IO, &why) == TROCAR_OK;
    pthread_getschedparam(pthread_self(), policy, &p);
    if (granted) assert_int_equal(p.sched_priority, PRIORITY_IO);
    else assert_non_null(strstr(why.text, "ulimit -r"));
    return granted ? policy : NULL;
}

static void priority_is_set_or_the_limit_is_reported(void **unused) {
    (void)unused;
    int policy = -1;
    pthread_t thread;
    void *granted;
    pthread_create(&thread, NULL, set_priority, &policy);
    pthread_join(thread, &granted);
    assert_int_equal(policy, granted != NULL ? SCHED_FIFO : SCHED_OTHER);
}

static void checking_does_not_change_the_thread(void **unused) {
    (void)unused;
    trocar_error why;
    realtime_check_permission(PRIORITY_HAPTIC, &why);
    assert_int_equal(sched_getscheduler(0), SCHED_OTHER);
    assert_int_equal(realtime_check_permission(1000, &why), TROCAR_SYSTEM); /* no system grants a priority this high */
    assert_non_null(strstr(why.text, "1000"));
}

static void *check_as_a_service(void *skipped) {
    trocar_error why = {""};
    *(bool *)skipped = !become_a_service();
    if (*(bool *)skipped) return NULL;
    if (use_fifo(0)) return "Linux let the flag be cleared";
    if (realtime_check_permission(PRIORITY_HAPTIC, &why) != TROCAR_OK) return strdup(why.text);
    if (realtime_set_priority(PRIORITY_IO, &why) != TROCAR_OK) return strdup(why.text);
    return sched_getscheduler(0) == (SCHED_FIFO | SCHED_RESET_ON_FORK) ? NULL : "the flag is gone";
}

static void uncleared_flag_is_kept(void **unused) {
    (void)unused;
    pthread_t thread;
    void *complaint;
    bool skipped;
    pthread_create(&thread, NULL, check_as_a_service, &skipped);
    pthread_join(thread, &complaint);
    if (skipped) skip();
    if (complaint != NULL) fail_msg("%s", (char *)complaint);
}

static void *check_without_permission(void *why) {
    return lose_realtime() ? (void *)(intptr_t)realtime_check_permission(PRIORITY_HAPTIC, why) : NULL;
}

static void missing_permission_has_its_own_status(void **unused) {
    (void)unused;
    trocar_error why = {""};
    pthread_t thread;
    void *status;
    pthread_create(&thread, NULL, check_without_permission, &why);
    pthread_join(thread, &status);
    assert_int_equal((intptr_t)status, TROCAR_NO_REALTIME);
    assert_non_null(strstr(why.text, "ulimit -r 80"));
}

/* Returns the amount of locked memory, in kB. */
static long locked_kilobytes(void) {
    char line[256];
    long kilobytes = -1;
    FILE *f = fopen("/proc/self/status", "r");
    while (f != NULL && fgets(line, sizeof line, f) != NULL) sscanf(line, "VmLck: %ld", &kilobytes);
    if (f != NULL) fclose(f);
    return kilobytes;
}

static void memory_is_locked_or_the_limit_is_reported(void **unused) {
    (void)unused;
    if (SANITIZED) skip(); /* sanitizers disable mlockall */
    trocar_error why = {""};
    if (realtime_lock_memory(&why) == TROCAR_OK) assert_true(locked_kilobytes() > 1000);
    else assert_non_null(strstr(why.text, "ulimit -l"));
    munlockall();
}

static void idle_states_are_disabled_or_the_reason_is_reported(void **unused) {
    (void)unused;
    trocar_error why = {""};
    int32_t allowed = -1;
    int descriptor = realtime_stay_awake(&why);
    if (descriptor < 0) {
        assert_non_null(strstr(why.text, "/dev/cpu_dma_latency: "));
        return;
    }
    int reader = open("/dev/cpu_dma_latency", O_RDONLY);
    if (reader >= 0) assert_int_equal(read(reader, &allowed, sizeof allowed), sizeof allowed);
    if (reader >= 0) assert_int_equal(allowed, 0); /* us, permitted wake-up latency of the processors */
    if (reader >= 0) close(reader);
    close(descriptor);
}

static void *policy_of_this_thread(void *unused) {
    (void)unused;
    return (void *)(intptr_t)sched_getscheduler(0);
}

static void *hurry_and_start_a_thread(void *hurried) {
    realtime_hurry();
    *(int *)hurried = sched_getscheduler(0);
    pthread_t thread;
    void *policy;
    pthread_create(&thread, NULL, policy_of_this_thread, NULL);
    pthread_join(thread, &policy);
    return policy;
}

static void timer_slack_is_not_inherited(void **unused) {
    (void)unused;
    int hurried = -1;
    pthread_t thread;
    void *policy;
    pthread_create(&thread, NULL, hurry_and_start_a_thread, &hurried);
    pthread_join(thread, &policy);
    assert_true(hurried == (SCHED_FIFO | SCHED_RESET_ON_FORK) || hurried == SCHED_OTHER); /* SCHED_OTHER if the kernel refuses the priority */
    assert_int_equal((intptr_t)policy, SCHED_OTHER);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(denormals_become_zero),
        cmocka_unit_test(a_touched_stack_does_not_fault),
        cmocka_unit_test(priority_is_set_or_the_limit_is_reported),
        cmocka_unit_test(checking_does_not_change_the_thread),
        cmocka_unit_test(uncleared_flag_is_kept),
        cmocka_unit_test(memory_is_locked_or_the_limit_is_reported),
        cmocka_unit_test(idle_states_are_disabled_or_the_reason_is_reported),
        cmocka_unit_test(timer_slack_is_not_inherited),
        cmocka_unit_test(missing_permission_has_its_own_status), /* must come last, because it lowers a limit for good */
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
