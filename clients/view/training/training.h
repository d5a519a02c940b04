/* A trainee's task: its description for the page, the recording of the run, and the report. trocar-score reads the task and makes the report from the
   recording, so that scoring the recording again later gives the same numbers. */
#ifndef TROCAR_TRAINING_H
#define TROCAR_TRAINING_H

#include <lcm/lcm.h>
#include <sys/types.h>

#include "base/error.h"
#include "shared/json.h"
#include "view/implant/implant.h"
#include "view/stream/subscriber.h"

enum { TRAINING_PATH = 1024 };

typedef enum { TRAINING_READY, TRAINING_RUNNING, TRAINING_SCORING, TRAINING_SCORED } training_state;

typedef struct {
    const char *task;        /* path of the task; NULL if there is none */
    char runs[TRAINING_PATH];     /* folder of the trainee's runs */
    char prepared[TRAINING_PATH]; /* folder with task.json and plan.csv, for the page and the viewer */
    char scene[TRAINING_PATH], name[64], plan[TRAINING_PATH], source[64]; /* contents of the task; "" where it has none */
    double strength, prescription;   /* U and Gy; 0 if the task has none */

    lcm_t *lcm;
    lcm_subscription_t *heard;
    lcm_eventlog_t *log;     /* the recording, while the task is running; otherwise NULL */
    bool full;               /* true if an event could not be written */
    int64_t events;
    training_state state;
    double began, ended;     /* s, times of the task's beginning and end, on the clock of subscriber_time */
    char run[128];           /* NAME/TIME: path of the last run's files in `runs`, without their extensions */
    pid_t scorer;            /* process ID of trocar-score while it runs; otherwise 0 */
    int said;                /* descriptor of an in-memory file that receives the output of trocar-score */
    bool has_report;
    char message[512];       /* what went wrong, or ""; shown on the page */
} training;

/* Runs trocar-score to read the task; trocar-score must be in the folder of this program. `runs`: NULL for the default, a folder in the user's home. BAD_INPUT
   with the message of trocar-score if the task cannot be used. */
trocar_status training_prepare(training *t, const char *task, const char *runs, trocar_error *why);

/* Subscribes to the messages to be recorded. Call after subscriber_open. */
trocar_status training_open(training *t, lcm_t *lcm, trocar_error *why);
void training_close(training *t);

/* Starts the task and its recording. Refused with a message for the page while seeds or tracks of earlier needles are in the tissue. */
void training_start(training *t, subscriber *feed);

/* Ends the task, and starts trocar-score. `language`: language of the report, as two ASCII letters, the first in the lowest byte; 0 for English. */
void training_finish(training *t, const subscriber *feed, uint32_t language);

/* Checks whether trocar-score has ended. Does not wait. */
void training_poll(training *t);

/* Writes the member "task" of the page's status: state, elapsed time (s), the report's path without its extension, and the message. */
void training_write(training *t, const subscriber *feed, json *j);

#endif
