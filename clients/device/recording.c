#include "device/recording.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

#include "shared/events.h"
#include "shared/json.h"
#include "trocar.h"

/* Makes room for one more element in a growing array. */
static trocar_status grow(void **array, int count, int *room, size_t size, trocar_error *why) {
    if (count < *room) return TROCAR_OK;
    int wider = *room ? 2 * *room : 4096;
    void *moved = realloc(*array, (size_t)wider * size);
    if (!moved) return fail(why, TROCAR_NO_MEMORY, "no memory to record %d messages", wider);
    *array = moved;
    *room = wider;
    return TROCAR_OK;
}

trocar_status recording_add_pose(recording *r, double time, pose base, trocar_error *why) {
    void *array = r->sent;
    trocar_status status = grow(&array, r->sent_count, &r->sent_room, sizeof *r->sent, why);
    r->sent = array;
    if (status == TROCAR_OK) r->sent[r->sent_count++] = (sent_pose){.time = time, .base = base};
    return status;
}

trocar_status recording_add_wrench(recording *r, double time, const trocar_needle_wrench_t *wrench, trocar_error *why) {
    if (wrench->session != r->session || wrench->pose_seq < 0 || wrench->pose_seq >= r->sent_count) return TROCAR_OK;
    void *array = r->received;
    trocar_status status = grow(&array, r->received_count, &r->received_room, sizeof *r->received, why);
    r->received = array;
    if (status != TROCAR_OK) return status;
    sent_pose *asked = &r->sent[wrench->pose_seq];
    double round_trip = asked->answered ? NAN : time - asked->time;
    asked->answered = true;
    r->received[r->received_count++] = (received_wrench){.time = time, .round_trip = round_trip, .wrench = *wrench};
    return TROCAR_OK;
}

void recording_free(recording *r) {
    free(r->sent);
    free(r->received);
    *r = (recording){0};
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Returns the nearest-rank percentile of sorted values, or NaN if there are none. */
static double percentile(const double *sorted, int count, double fraction) {
    return count ? sorted[(int)fmax(ceil(fraction * count) - 1, 0)] : NAN;
}

static void summarise_round_trips(const recording *r, double *scratch, recording_summary *s) {
    int count = 0;
    for (int i = 0; i < r->received_count; i++) {
        const received_wrench *w = &r->received[i];
        if (w->time >= r->start && !isnan(w->round_trip)) scratch[count++] = w->round_trip;
    }
    qsort(scratch, (size_t)count, sizeof *scratch, ascending);
    s->round_trip_p50 = percentile(scratch, count, 0.5);
    s->round_trip_p99 = percentile(scratch, count, 0.99);
    s->round_trip_max = percentile(scratch, count, 1.0);
}

static void summarise_poses(const recording *r, recording_summary *s) {
    for (int i = 0; i < r->sent_count; i++) {
        if (r->sent[i].time < r->start) continue;
        s->sent++;
        s->unanswered_poses += !r->sent[i].answered;
    }
}

static void widen(const double value[3], double least[3], double greatest[3]) {
    for (int i = 0; i < 3; i++) {
        least[i] = fmin(least[i], value[i]);
        greatest[i] = fmax(greatest[i], value[i]);
    }
}

/* Returns the component of the raw force along the needle (N), positive towards the tip. */
static double axial_force(const recording *r, const trocar_needle_wrench_t *w) {
    return v3_dot(q_axis(r->sent[w->pose_seq].base.orientation), v3(w->raw_force[0], w->raw_force[1], w->raw_force[2]));
}

static void note_puncture(const trocar_needle_wrench_t *w, double time, double force_before, recording_summary *s) {
    if (s->puncture_count < SUMMARY_MAX_PUNCTURES)
        s->punctures[s->puncture_count] = (puncture){time, w->depth, force_before, w->membrane};
    s->puncture_count++;
}

static void note_jump(const trocar_needle_wrench_t *before, const trocar_needle_wrench_t *after, double time,
                      recording_summary *s) {
    const double *a = before->raw_force, *b = after->raw_force;
    double jump = v3_norm(v3(b[0] - a[0], b[1] - a[1], b[2] - a[2]));
    bool at_puncture = (before->events | after->events) & TROCAR_EVENT_PUNCTURED;
    if (at_puncture || after->tick != before->tick + 1 || jump <= s->largest_jump) return;
    s->largest_jump = jump;
    s->jump_time = time;
    s->jump_force = v3_norm(v3(b[0], b[1], b[2]));
}

static void summarise_wrenches(const recording *r, recording_summary *s) {
    const trocar_needle_wrench_t *last = NULL;
    for (int i = 0; i < r->received_count; i++) {
        if (r->received[i].time < r->start) continue;
        const trocar_needle_wrench_t *w = &r->received[i].wrench;
        double time = r->received[i].time - r->start;
        s->received++;
        widen(w->force, s->least_force, s->greatest_force);
        widen(w->torque, s->least_torque, s->greatest_torque);
        s->deepest = fmax(s->deepest, w->depth);
        if (w->contacts > s->most_contacts) s->most_contacts = w->contacts;
        s->flags |= w->flags;
        if (w->events & TROCAR_EVENT_PUNCTURED) note_puncture(w, time, axial_force(r, last ? last : w), s);
        if (last) note_jump(last, w, time, s);
        if (last && w->server == last->server && w->tick > last->tick) s->lost_wrenches += w->tick - last->tick - 1;
        last = w;
    }
}

trocar_status recording_summarise(const recording *r, recording_summary *summary, trocar_error *why) {
    *summary = (recording_summary){.skipped_periods = r->skipped_periods, .foreign_wrenches = r->foreign_wrenches};
    double *scratch = calloc((size_t)r->received_count + 1, sizeof *scratch);
    if (!scratch) return fail(why, TROCAR_NO_MEMORY, "no memory to sort %d round trips", r->received_count);
    summarise_round_trips(r, scratch, summary);
    free(scratch);
    summarise_poses(r, summary);
    summarise_wrenches(r, summary);
    return TROCAR_OK;
}

static int listed_punctures(const recording_summary *s) {
    return s->puncture_count < SUMMARY_MAX_PUNCTURES ? s->puncture_count : SUMMARY_MAX_PUNCTURES;
}

void summary_print(const recording_summary *s, FILE *out) {
    fprintf(out, "poses sent          %d (%d not answered, %d periods skipped)\n", s->sent, s->unanswered_poses,
            s->skipped_periods);
    fprintf(out, "wrenches received   %d (%" PRId64 " lost)\n", s->received, s->lost_wrenches);
    if (s->foreign_wrenches) fprintf(out, "of another server   %" PRId64 " wrenches ignored: stop one of the two servers\n", s->foreign_wrenches);
    fprintf(out, "round trip          p50 %.3f ms, p99 %.3f ms, max %.3f ms\n", 1e3 * s->round_trip_p50,
            1e3 * s->round_trip_p99, 1e3 * s->round_trip_max);
    for (int i = 0; i < 3; i++)
        fprintf(out, "on the hand, %c      force %+.3f to %+.3f N, torque %+.4f to %+.4f N m\n", 'x' + i, s->least_force[i],
                s->greatest_force[i], s->least_torque[i], s->greatest_torque[i]);
    fprintf(out, "deepest             %.1f mm, %d contacts\n", 1e3 * s->deepest, s->most_contacts);
    fprintf(out, "punctures           %d\n", s->puncture_count);
    for (int i = 0; i < listed_punctures(s); i++) {
        const puncture *p = &s->punctures[i];
        fprintf(out, "  membrane %d        at %.3f s, track %.1f mm long, axial force %+.3f N just before\n", p->membrane,
                p->time, 1e3 * p->depth, p->force);
    }
    fprintf(out, "largest jump        %.4f N in one tick, of %.3f N at %.3f s, except at punctures\n", s->largest_jump,
            s->jump_force, s->jump_time);
    char flags[160];
    flags_text((unsigned)s->flags, flags, sizeof flags);
    fprintf(out, "flags               %s\n", s->flags ? flags : "none");
}

static void write_punctures(const recording_summary *s, json *j) {
    json_open(j, "punctures", '[');
    for (int i = 0; i < listed_punctures(s); i++) {
        const puncture *p = &s->punctures[i];
        json_open(j, NULL, '{');
        json_integer(j, "membrane", p->membrane);
        json_number(j, "time_s", p->time);
        json_number(j, "depth_m", p->depth);
        json_number(j, "axial_force_N", p->force);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static void write_flags(unsigned flags, json *j) {
    unsigned bit;
    const char *word;
    json_open(j, "flags", '[');
    for (int i = 0; flag_at(i, &bit, &word); i++)
        if (flags & bit) json_text(j, NULL, word);
    json_close(j, ']');
}

void summary_write_json(const recording_summary *s, FILE *out) {
    const struct { const char *name; int64_t value; } counts[] = {
        {"poses_sent", s->sent}, {"poses_unanswered", s->unanswered_poses}, {"periods_skipped", s->skipped_periods},
        {"wrenches_received", s->received}, {"wrenches_lost", s->lost_wrenches}, {"wrenches_of_other_servers", s->foreign_wrenches},
        {"most_contacts", s->most_contacts}, {"puncture_count", s->puncture_count},
    };
    const struct { const char *name; const double *values; int count; } numbers[] = {
        {"round_trip_p50_s", &s->round_trip_p50, 1}, {"round_trip_p99_s", &s->round_trip_p99, 1}, {"round_trip_max_s", &s->round_trip_max, 1},
        {"least_force_N", s->least_force, 3}, {"greatest_force_N", s->greatest_force, 3},
        {"least_torque_Nm", s->least_torque, 3}, {"greatest_torque_Nm", s->greatest_torque, 3},
        {"deepest_m", &s->deepest, 1}, {"largest_jump_N", &s->largest_jump, 1}, {"largest_jump_time_s", &s->jump_time, 1},
        {"largest_jump_of_N", &s->jump_force, 1},
    };
    json j = {.out = out};
    json_open(&j, NULL, '{');
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) json_line(&j), json_integer(&j, counts[i].name, counts[i].value);
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        json_line(&j);
        if (numbers[i].count == 1) json_number(&j, numbers[i].name, *numbers[i].values);
        else json_numbers(&j, numbers[i].name, numbers[i].values, numbers[i].count);
    }
    json_line(&j), write_punctures(s, &j);
    json_line(&j), write_flags((unsigned)s->flags, &j);
    fputs("\n", out);
    json_close(&j, '}');
    fputs("\n", out);
}

static void csv_numbers(const double *numbers, int count, FILE *out) {
    for (int i = 0; i < count; i++) fprintf(out, "%.9g,", numbers[i]);
}

/* Writes a force or torque, in the patient's axes unless `patient` is NULL. */
static void csv_vector(const patient_frame *patient, const double v[3], FILE *out) {
    vec3 shown = axes_to_patient(patient, v3(v[0], v[1], v[2]));
    csv_numbers(&shown.x, 3, out);
}

static void csv_row(const received_wrench *row, double start, pose base, const patient_frame *patient, FILE *out) {
    const trocar_needle_wrench_t *w = &row->wrench;
    char membrane[16], events[160];
    snprintf(membrane, sizeof membrane, "%d", w->membrane);
    events_text((unsigned)w->events, membrane, events, sizeof events);
    base = (pose){mesh_to_patient(patient, base.position), turn_to_patient(patient, base.orientation)};
    fprintf(out, "%.6f,", row->time - start);
    csv_vector(patient, w->force, out);
    csv_vector(patient, w->torque, out);
    fprintf(out, "%.9g,%d,%s,", w->depth, w->contacts, events);
    csv_vector(patient, w->raw_force, out);
    csv_vector(patient, w->raw_torque, out);
    csv_numbers(&base.position.x, 3, out);
    csv_numbers(&base.orientation.w, 4, out);
    fprintf(out, "%" PRId64 ",%" PRId64 ",%d,%.9g,%d\n", w->tick, w->pose_seq, w->flags, row->round_trip, w->needle);
}

void recording_write_csv(const recording *r, const patient_frame *patient, FILE *out) {
    const char *unit = patient_unit(patient);
    fprintf(out, "t [s],fx [N],fy [N],fz [N],tx [N m],ty [N m],tz [N m],depth [m],contacts,events,"
                 "raw_fx [N],raw_fy [N],raw_fz [N],raw_tx [N m],raw_ty [N m],raw_tz [N m],"
                 "x [%s],y [%s],z [%s],qw,qx,qy,qz,tick,pose_seq,flags,round_trip [s],needle\n", unit, unit, unit);
    for (int i = 0; i < r->received_count; i++) {
        const received_wrench *row = &r->received[i];
        if (row->time >= r->start) csv_row(row, r->start, r->sent[row->wrench.pose_seq].base, patient, out);
    }
}
