/* Records the messages that a device sends and receives, and summarises the forces and the quality of the connection. */
#ifndef TROCAR_RECORDING_H
#define TROCAR_RECORDING_H

#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"
#include "shared/patient.h"
#include "trocar_needle_wrench_t.h"

/* All times are in s, by the device's own clock. */
typedef struct { double time; pose base; bool answered; } sent_pose;
typedef struct {
    double time;             /* s, arrival time */
    double round_trip;       /* s from sending the pose to its first answer; NaN for later answers to it */
    trocar_needle_wrench_t wrench;
} received_wrench;

typedef struct {
    int64_t session;
    double start;            /* when the script starts; messages before that are not counted */
    int sent_count, sent_room;
    sent_pose *sent;         /* array [sent_count], in the order of seq */
    int received_count, received_room;
    received_wrench *received;
    int skipped_periods;     /* periods that the device's own loop skipped */
    int64_t foreign_wrenches; /* wrenches ignored because they came from a server other than the one followed */
} recording;

enum { SUMMARY_MAX_PUNCTURES = 16 };

/* time: s since the start; depth: m; force: axial raw force, N; membrane: index in the scene */
typedef struct { double time, depth, force; int membrane; } puncture;

typedef struct {
    int sent, received;
    int64_t lost_wrenches;   /* ticks missing from the received wrenches */
    int64_t foreign_wrenches; /* wrenches that came from another server */
    int unanswered_poses;    /* poses that were lost, or replaced by a newer one before any tick used them */
    int skipped_periods;
    double round_trip_p50, round_trip_p99, round_trip_max;   /* s; NaN if no wrench arrived */
    double least_force[3], greatest_force[3];                /* N, extremes of the rendered force along each world axis */
    double least_torque[3], greatest_torque[3];              /* N m */
    int puncture_count;      /* punctures in all, which may be more than the list holds */
    puncture punctures[SUMMARY_MAX_PUNCTURES];
    double largest_jump;     /* N, largest change in the raw force between two ticks, leaving out punctures and the ticks right after them */
    double jump_time;        /* s since the start, when that happened */
    double jump_force;       /* N, magnitude of the raw force at jump_time */
    double deepest;          /* m */
    int most_contacts;
    int32_t flags;           /* every flag that was ever set */
} recording_summary;

/* Each records one message: a pose, whose sequence number is its index, or a wrench. Wrenches of other sessions are ignored. Returns NO_MEMORY if the recording
   cannot grow. */
trocar_status recording_add_pose(recording *r, double time, pose base, trocar_error *why);
trocar_status recording_add_wrench(recording *r, double time, const trocar_needle_wrench_t *wrench, trocar_error *why);
void recording_free(recording *r);

trocar_status recording_summarise(const recording *r, recording_summary *summary, trocar_error *why);

void summary_print(const recording_summary *s, FILE *out);       /* prints the summary as text */
void summary_write_json(const recording_summary *s, FILE *out);

/* Writes one row per wrench received since the start, in patient coordinates, or in mesh coordinates if `patient` is NULL. The column names include units. */
void recording_write_csv(const recording *r, const patient_frame *patient, FILE *out);

#endif
