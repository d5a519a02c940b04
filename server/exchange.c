#include "exchange.h"

#include <errno.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "intake/pose_arbiter.h"
#include "intake/safety_limits.h"
#include "loop.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_probe_wrench_t.h"

enum { COMMANDS = 64, PROBE_WRENCHES = 64, WRENCHES = 1024, OUTGOING = 256, LATENCIES = 4096 }; /* WRENCHES: one second of one needle's wrenches at 1 kHz.
                                                                                                   LATENCIES: far more than arrive between two telemetry
                                                                                                   messages */

static trocar_status create_eventfd(int *descriptor, trocar_error *why) {
    *descriptor = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    return *descriptor >= 0 ? TROCAR_OK : fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
}

/* Returns the buffer's slot with this index. */
static view_sample *view_at(const triple_buffer *views, size_t index) { return (view_sample *)(void *)(views->slots + index * views->size); }

trocar_status views_create(triple_buffer *views, trocar_model *model, trocar_error *why) {
    trocar_status status = triple_buffer_create(views, sizeof(view_sample), why);
    for (size_t i = 0; i < 3 && model != NULL && status == TROCAR_OK; i++) status = trocar_picture_create(model, &view_at(views, i)->picture, why);
    if (status != TROCAR_OK) views_free(views);
    return status;
}

void views_free(triple_buffer *views) {
    for (size_t i = 0; i < 3 && views->slots != NULL; i++) trocar_picture_free(view_at(views, i)->picture);
    triple_buffer_free(views);
}

void view_copy(const view_sample *from, view_sample *to) {
    trocar_picture *own = to->picture;
    *to = *from;
    to->picture = own;
    if (own != NULL) trocar_picture_copy(from->picture, own);
}

static trocar_status create_all(exchange *x, trocar_model *model, trocar_error *why) {
    trocar_status status;
    if ((status = create_eventfd(&x->io_wake, why)) != TROCAR_OK) return status;
    if ((status = create_eventfd(&x->worker_wake, why)) != TROCAR_OK) return status;
    if ((status = triple_buffer_create(&x->poses, sizeof(newest_poses), why)) != TROCAR_OK) return status;
    if ((status = triple_buffer_create(&x->probe_poses, sizeof(probe_sample), why)) != TROCAR_OK) return status;
    if ((status = spsc_ring_create(&x->probe_wrenches, sizeof(trocar_probe_wrench_t), PROBE_WRENCHES, why)) != TROCAR_OK) return status;
    if ((status = views_create(&x->views, model, why)) != TROCAR_OK) return status;
    if ((status = triple_buffer_create(&x->loops, sizeof(loop_record), why)) != TROCAR_OK) return status;
    if ((status = triple_buffer_create(&x->intakes, sizeof(arbiter_record), why)) != TROCAR_OK) return status;
    if ((status = triple_buffer_create(&x->faults, sizeof(worker_fault), why)) != TROCAR_OK) return status;
    size_t wrenches = WRENCHES * (size_t)(model != NULL ? trocar_model_needles(model) : 1);
    if ((status = spsc_ring_create(&x->wrenches, sizeof(trocar_needle_wrench_t), wrenches, why)) != TROCAR_OK) return status;
    if ((status = spsc_ring_create(&x->commands, sizeof(needle_command), COMMANDS, why)) != TROCAR_OK) return status;
    if ((status = spsc_ring_create(&x->replies, sizeof(needle_command), COMMANDS, why)) != TROCAR_OK) return status;
    if ((status = spsc_ring_create(&x->latencies, sizeof(int64_t), LATENCIES, why)) != TROCAR_OK) return status;
    return spsc_ring_create(&x->round_trips, sizeof(int64_t), LATENCIES, why);
}

trocar_status exchange_create(exchange *x, trocar_model *model, trocar_error *why) {
    *x = (exchange){.io_wake = -1, .worker_wake = -1, .relay_wake = -1};
    trocar_status status = create_all(x, model, why);
    if (status != TROCAR_OK) exchange_free(x);
    return status;
}

trocar_status exchange_add_relay(exchange *x, trocar_error *why) {
    trocar_status status = create_eventfd(&x->relay_wake, why);
    return status == TROCAR_OK ? spsc_ring_create(&x->outgoing, sizeof(outgoing_message), OUTGOING, why) : status;
}

void exchange_free(exchange *x) {
    triple_buffer_free(&x->poses);
    triple_buffer_free(&x->probe_poses);
    spsc_ring_free(&x->probe_wrenches);
    views_free(&x->views);
    triple_buffer_free(&x->loops);
    triple_buffer_free(&x->intakes);
    triple_buffer_free(&x->faults);
    spsc_ring_free(&x->wrenches);
    spsc_ring_free(&x->commands);
    spsc_ring_free(&x->replies);
    spsc_ring_free(&x->latencies);
    spsc_ring_free(&x->round_trips);
    spsc_ring_free(&x->outgoing);
    if (x->io_wake >= 0) close(x->io_wake);
    if (x->worker_wake >= 0) close(x->worker_wake);
    if (x->relay_wake >= 0) close(x->relay_wake);
    x->io_wake = x->worker_wake = x->relay_wake = -1;
}
