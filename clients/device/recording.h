/* The messages that a device sent and received, and a summary of the link and the forces. */
#ifndef TROCAR_RECORDING_H
#define TROCAR_RECORDING_H

#include <stdbool.h>

#include "base/report.h"
#include "base/vec.h"
#include "shared/patient.h"
#include "trocar_needle_wrench_t.h"

/* Times are in s, on one clock of the device. */
typedef struct { double time; pose base; bool answered; } sent_pose;
typedef struct {
    double time;             /* arrival */
    double round_trip;       /* s from the pose to its first answer; NaN for later answers to the same pose */
    trocar_needle_wrench_t wrench;
} received_wrench;

typedef struct {
    int64_t session;
    double start;            /* start of the script; earlier messages are not counted */
    int sent_count, sent_room;
    sent_pose *sent;         /* [sent_count], by sequence number */
    int received_count, received_room;
    received_wrench *received;
    int skipped_periods;     /* number of periods skipped by the device's own loop */
    int64_t foreign_wrenches; /* number of ignored wrenches from servers other than the followed one */
} recording;

enum { SUMMARY_MAX_PUNCTURES = 16 };

/* time: s from the start; depth: m; force: axial raw force, N; membrane: index in the scene */
typedef struct { double time, depth, force; int membrane; } puncture;

typedef struct {
    int sent, received;
    int64_t lost_wrenches;   /* number of gaps in the ticks */
    int64_t foreign_wrenches; /* number of wrenches from another server */
    int unanswered_poses;    /* number of poses that were lost, or superseded before a tick used them */
    int skipped_periods;
    double round_trip_p50, round_trip_p99, round_trip_max;   /* s; NaN if no wrench arrived */
    double least_force[3], greatest_force[3];                /* N, rendered force along the world axes */
    double least_torque[3], greatest_torque[3];              /* N m */
    int puncture_count;      /* may exceed the length of the list */
    puncture punctures[SUMMARY_MAX_PUNCTURES];
    double largest_jump;     /* N, largest change of the raw force per tick, except at punctures and in the tick after them */
    double jump_time;        /* s from the start */
    double jump_force;       /* N, magnitude of the raw force at that time */
    double deepest;          /* m */
    int most_contacts;
    int32_t flags;           /* flags that were set at any time */
} recording_summary;

/* Records a pose, whose sequence number is its index, or a wrench. Wrenches of other sessions are ignored. NO_MEMORY if the
   recording cannot grow. */
trocar_status recording_add_pose(recording *r, double time, pose base, report *why);
trocar_status recording_add_wrench(recording *r, double time, const trocar_needle_wrench_t *wrench, report *why);
void recording_free(recording *r);

trocar_status recording_summarise(const recording *r, recording_summary *summary, report *why);

void summary_print(const recording_summary *s, FILE *out);       /* as text */
void summary_write_json(const recording_summary *s, FILE *out);

/* Writes one row per wrench since the start; column names include units. Values are in patient coordinates, or in the mesh's if `patient` is NULL. */
void recording_write_csv(const recording *r, const patient_frame *patient, FILE *out);

#endif
