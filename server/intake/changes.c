#include "intake/changes.h"

#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <string.h>

#include "base/error.h"
#include "common/eventfd_signal.h"
#include "common/message_fit.h"
#include "trocar_change_t.h"

static void show(change_intake *in) {
    char key[TROCAR_CHANGE_KEY];
    for (int i = 0; i < in->shown.count; i++) trocar_change_at(in->newest, i, key, &in->shown.value[i]);
}

trocar_status changes_create(change_intake *in, const trocar_sim *sim, trocar_error *why) {
    *in = (change_intake){.wake = in->wake};
    trocar_status status = trocar_change_create(sim, &in->newest, why);
    if (status != TROCAR_OK) return status;
    int count = trocar_change_count(in->newest);
    in->shown.key = calloc((size_t)count, sizeof *in->shown.key);
    in->shown.value = calloc((size_t)count, sizeof *in->shown.value);
    char *keys = calloc((size_t)count, TROCAR_CHANGE_KEY);
    if (keys && in->shown.key && in->shown.value) {
        for (int i = 0; i < count; i++) trocar_change_at(in->newest, i, in->shown.key[i] = keys + (size_t)i * TROCAR_CHANGE_KEY, &in->shown.value[i]);
        in->shown.count = count;
        return TROCAR_OK;
    }
    free(keys);
    changes_free(in);
    return fail(why, TROCAR_NO_MEMORY, "no memory for the values that may change");
}

static change_verdict refuse(needle_command *command, const char *reason) {
    command->refused = true;
    snprintf(command->why, sizeof command->why, "%.*s", (int)sizeof command->why - 1, reason);
    return CHANGE_REFUSED;
}

static int is_cancelled(void *context) { return atomic_load_explicit(&((change_intake *)context)->cancelled, memory_order_relaxed); }

static void *build(void *context) {
    enum { NICE = 10 }; /* nice value of the thread, which gives precedence to the simulation's worker */
    change_intake *in = context;
    setpriority(PRIO_PROCESS, 0, NICE); /* 0: this thread */
    trocar_watch watch = {.cancelled = is_cancelled, .context = in};
    in->status = trocar_change_prepare(in->last.change, &watch, &in->why);
    atomic_store_explicit(&in->built, true, memory_order_release);
    eventfd_signal(in->wake);
    return NULL;
}

/* Starts the builder thread at normal priority, even if the calling thread's is higher. */
static bool start_builder(change_intake *in) {
    pthread_attr_t attributes;
    in->built = in->cancelled = false;
    if (pthread_attr_init(&attributes) != 0) return false;
    pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
    in->building = pthread_create(&in->builder, &attributes, build, in) == 0;
    pthread_attr_destroy(&attributes);
    return in->building;
}

change_verdict changes_ready(change_intake *in, needle_command *command) {
    if (!in->building || !atomic_load_explicit(&in->built, memory_order_acquire)) return CHANGE_LATER;
    pthread_join(in->builder, NULL);
    in->building = false;
    *command = in->last;
    if (in->status == TROCAR_OK) return CHANGE_PASS_ON;
    refuse(command, in->why.text);
    changes_settle(in, command);
    return CHANGE_REFUSED;
}

static change_verdict prepare(change_intake *in, const trocar_change_t *m, needle_command *command) {
    trocar_error why;
    trocar_change *changed;
    command->change_time = m->time == 0.0 ? TROCAR_CHANGE_TIME : m->time;
    if (!in->newest) return refuse(command, "this server has no simulation");
    if (in->busy) return refuse(command, "too many changes at once: wait for the reply");
    in->busy = true;
    if (in->pending) return refuse(command, "another change is in progress: wait for its reply");
    if (!(command->change_time >= TROCAR_CHANGE_TIME_LEAST && command->change_time <= TROCAR_CHANGE_TIME_MOST))
        return refuse(command, "time: expected 0.1 to 60 s, or 0 for the default");
    if (strlen(m->values) > CHANGE_TEXT_MOST) return refuse(command, "values: more than 512 bytes: send several changes");
    if (trocar_change_copy(in->newest, &changed, &why) != TROCAR_OK) return refuse(command, why.text);
    if (trocar_change_set(changed, m->values, &why) != TROCAR_OK) {
        trocar_change_free(changed);
        return refuse(command, why.text);
    }
    command->change = changed;
    command->replaced = in->newest;
    in->newest = changed;
    in->pending = true;
    in->last = *command;
    if (trocar_change_prepared(changed)) return CHANGE_PASS_ON;
    if (start_builder(in)) return CHANGE_LATER;
    refuse(command, "no thread to build the model with the new moduli");
    changes_settle(in, command);
    return CHANGE_REFUSED;
}

change_verdict changes_take(change_intake *in, const void *data, size_t size, needle_command *command) {
    trocar_change_t m = {0};
    if (!change_fits(data, size) || trocar_change_t_decode(data, 0, (int)size, &m) != (int)size) return CHANGE_MALFORMED;
    *command = (needle_command){.asked = {.utime = m.utime, .session = m.session, .command = TROCAR_COMMAND_T_CHANGE, .seq = m.seq}};
    change_verdict verdict = prepare(in, &m, command);
    trocar_change_t_decode_cleanup(&m);
    return verdict;
}

void changes_settle(change_intake *in, const needle_command *done) {
    if (!done->change) return;
    in->pending = false;
    if (!done->refused) {
        trocar_change_free(done->replaced);
        show(in);
        return;
    }
    in->newest = done->replaced;
    trocar_change_free(done->change);
}

void changes_free(change_intake *in) {
    if (in->building) {
        atomic_store(&in->cancelled, true);
        pthread_join(in->builder, NULL);
        in->last.refused = true;
        changes_settle(in, &in->last);
    }
    trocar_change_free(in->newest);
    if (in->shown.count > 0) free(in->shown.key[0]); /* all keys are allocated as one block */
    free(in->shown.key);
    free(in->shown.value);
    *in = (change_intake){.newest = NULL};
}
