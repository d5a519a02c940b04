#include "scale_timing.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "api/api.h"
#include "insertion/tip/prefetch.h"
#include "insertion/tip/tip.h"

static const double REST = 0.5; /* s, rest before a script starts, so that the needle's line has been measured */

/* A contact node of the needle, followed from its request to its activation. */
typedef struct {
    uint64_t id;
    double asked;            /* s, time of the request */
    double due;              /* s, when the node should be active because the tip has left its element; INFINITY until then */
    bool answered, active, late;
} followed;

typedef struct {
    trocar_sim *sim;
    insertion_state state;
    compliance_snapshot *snapshot, *next; /* the one in use, and the one being computed */
    double speed;            /* m/s, of the hand, but at least 1 mm/s */
    double now, ready;       /* s; now: model time; ready: when `next` is finished, negative if the worker is idle */
    double idle;             /* s, time up to which the worker's idle time has been used */
    int tet;                 /* the element the tip is in */
    double entered_at, entered_depth; /* when (s) and how deep (m) the tip entered the element */
    int contact_count;
    followed contacts[MAX_CONTACTS];  /* the contacts in the needle's state */
    bool free_patches;
    scale_timing *result;
} scale_run;

/* Uses the worker's idle time since the last answer to prepare nodes in advance. A slice that takes longer than the elapsed time delays the next one. */
static void look_ahead(scale_run *run) {
    bool more = true;
    while (more && run->idle < run->now) {
        int64_t start = processor_ns();
        more = remesher_look_ahead(run->sim->needles[0].remesher);
        run->idle += 1e-9 * (double)(processor_ns() - start);
    }
    if (!more) run->idle = fmax(run->idle, run->now);
}

/* When the worker has finished a request, it takes the newest one. After computing the rows, it measures the mesh's resolution along new lines, one at a
   time, until a newer request arrives. */
static trocar_status work(scale_run *run, trocar_error *why) {
    if (run->ready >= 0.0 && run->ready <= run->now) {
        compliance_snapshot *old = run->snapshot;
        run->snapshot = run->next;
        run->next = old;
        run->ready = -1.0;
    }
    if (run->ready >= 0.0) return TROCAR_OK;
    bool fresh = run->snapshot->serial != run->state.request.serial;
    remesher *r = run->sim->needles[0].remesher;
    if (!fresh && !remesher_must_measure(r, &run->state.request)) {
        look_ahead(run);
        return TROCAR_OK;
    }
    double begin = fmax(run->now, run->idle); /* the current slice of idle work is finished first */
    int64_t start = processor_ns();
    trocar_status status = fresh ? remesher_serve(r, &run->state.request, run->next, why)
                                 : remesher_measure(r, &run->state.request, 1, run->next, why);
    int64_t taken = processor_ns() - start;
    histogram_add(fresh ? &run->result->serve : &run->result->patch, taken);
    if (status == TROCAR_OK && run->free_patches) status = remesher_measure(r, &run->state.request, MAX_PIECES + MAX_CONTACTS, run->next, why);
    run->ready = run->idle = begin + 1e-9 * (double)taken;
    return status;
}

/* Removes all contact nodes after the first `kept` from the records. */
static void forget(scale_run *run, int kept) {
    for (; run->contact_count > kept; run->contact_count--) run->result->unanswered += !run->contacts[run->contact_count - 1].answered;
}

static void follow_contacts(scale_run *run) {
    const refinement *now = &run->state.refined;
    int kept = 0;
    while (kept < run->contact_count && kept < now->count && run->contacts[kept].id == now->nodes[now->order[kept]].id) kept++;
    forget(run, kept);
    for (; run->contact_count < now->count; run->contact_count++, run->result->contacts++)
        run->contacts[run->contact_count] = (followed){.id = now->nodes[now->order[run->contact_count]].id, .asked = run->now, .due = INFINITY};
}

/* An element's contact node should be active when the tip leaves the element or, after a jump at a membrane, when the tip would have left it at the hand's
   speed. */
static void leave_element(scale_run *run) {
    double depth = run->state.tip.place.depth, due = fmax(run->now, run->entered_at + (depth - run->entered_depth) / run->speed);
    for (int i = 0; i < contacts_passed(&run->state); i++)
        if (run->state.refined.nodes[run->state.refined.order[i]].tet != run->state.tip.place.tet) run->contacts[i].due = fmin(run->contacts[i].due, due);
    run->result->crossings++;
}

static void note_progress(scale_run *run) {
    int known = snapshot_known_contacts(run->snapshot, &run->state.refined);
    for (int i = 0; i < run->contact_count; i++) {
        followed *contact = &run->contacts[i];
        bool takes_part = contact_is_active(&run->state, i);
        if (i < known && !contact->answered) histogram_add(&run->result->crossing, (int64_t)(1e9 * (run->now - contact->asked)));
        if (takes_part && !contact->active) histogram_add(&run->result->activation, (int64_t)(1e9 * fmax(run->now - contact->due, 0.0)));
        if (i >= contacts_passed(&run->state)) contact->due = INFINITY; /* the needle has been drawn back past the node */
        if (!takes_part && !contact->active && !contact->late && run->now >= contact->due) {
            contact->late = true;
            run->result->late_crossings++;
        }
        contact->answered |= i < known;
        contact->active |= takes_part;
    }
}

static void note_crossing(scale_run *run) {
    const insertion_state *state = &run->state;
    int tet = state->tip.place.phase == TIP_INSIDE ? state->tip.place.tet : -1;
    follow_contacts(run);
    if (tet >= 0 && run->tet >= 0 && tet != run->tet && state->tip.place.depth > run->entered_depth) leave_element(run);
    if (tet >= 0 && tet != run->tet) {
        run->entered_at = run->now;
        run->entered_depth = state->tip.place.depth;
    }
    note_progress(run);
    run->tet = tet;
}

static trocar_status run_tick(scale_run *run, pose base, double dt, trocar_error *why) {
    tick_output wrench;
    trocar_status status = work(run, why);
    if (status != TROCAR_OK) return status;
    int64_t start = processor_ns();
    insertion_tick(&(tick_input){.model = &run->sim->model->parts.insertion, .snapshot = run->snapshot, .base = {.pose = base}, .dt = dt},
                   &run->state, run->sim->workspace, &wrench);
    histogram_add(&run->result->tick, processor_ns() - start);
    run->result->late_ticks += (wrench.events & EVENT_LATE) != 0;
    if (wrench.contacts > run->result->most_contacts) run->result->most_contacts = wrench.contacts;
    note_crossing(run);
    return TROCAR_OK;
}

static pose base_at(const scale_case *wanted, double t) {
    if (wanted->script) return motion_pose(wanted->script, wanted->start, t - REST);
    pose base = wanted->start;
    base.position = v3_add(base.position, q_rotate(base.orientation, v3(0, 0, t * wanted->speed)));
    return base;
}

void scale_timing_set_spacing(trocar_model *model, double spacing) { model->parts.insertion.settings.contact_spacing = spacing; }

trocar_status scale_timing_measure(trocar_sim *sim, const scale_case *wanted, scale_timing *result, trocar_error *why) {
    memset(result, 0, sizeof *result);
    scale_run *run = calloc(1, sizeof *run);
    if (run) *run = (scale_run){.sim = sim, .result = result, .ready = -1.0, .tet = -1, .snapshot = calloc(1, sizeof *run->snapshot),
                                .next = calloc(1, sizeof *run->next)};
    trocar_status status = run && run->snapshot && run->next ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for a snapshot");
    if (status == TROCAR_OK) {
        run->free_patches = wanted->free_patches;
        insertion_reset(&sim->model->parts.insertion, wanted->start, &run->state);
    }
    double duration = wanted->script ? REST + wanted->script->duration : wanted->depth / wanted->speed;
    result->ticks = (int)(duration / wanted->dt);
    pose before = wanted->start;
    for (int i = 1; i <= result->ticks && status == TROCAR_OK; i++) {
        run->now = i * wanted->dt;
        pose base = base_at(wanted, run->now);
        run->speed = fmax(v3_norm(v3_sub(base.position, before.position)) / wanted->dt, 1e-3);
        status = run_tick(run, base, wanted->dt, why);
        before = base;
    }
    if (run) {
        forget(run, 0);
        free(run->snapshot);
        free(run->next);
    }
    free(run);
    return status;
}
