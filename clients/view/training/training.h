/* A trainee's task: its description for the page, the recording of the run, and the report. trocar-score both reads the task and makes the report from the
   recording, so scoring the recording again later gives the same numbers. */
#ifndef TROCAR_TRAINING_H
#define TROCAR_TRAINING_H

#include <lcm/lcm.h>
#include <sys/types.h>

#include "base/error.h"
#include "shared/json.h"
#include "view/hand/pilot.h"

enum { TRAINING_PATH = 1024 };

typedef enum { TRAINING_READY, TRAINING_CLEARING, TRAINING_RUNNING, TRAINING_SCORING, TRAINING_SCORED } training_state;

typedef struct {
    const char *task;        /* path of the task; NULL for none */
    char runs[TRAINING_PATH];     /* folder for the trainee's runs */
    char prepared[512];      /* temporary folder with task.json and plan.csv, for the page and the viewer; "" before it exists */
    char scene[TRAINING_PATH], name[64], plan[TRAINING_PATH], source[64]; /* from the task; "" where it has none */
    double strength, prescription;   /* U and Gy; 0 where the task has none */

    lcm_t *lcm;
    lcm_subscription_t *heard;
    pilot *hand;             /* asks the server to clear the tissue */
    lcm_eventlog_t *log;     /* the recording while the task is running, otherwise NULL */
    bool full;               /* true if an event could not be written */
    int64_t events;
    training_state state;
    training_state before;   /* while clearing: the state to return to if the task cannot start */
    int64_t asked_at;        /* ns, monotonic: while clearing, when the server was asked to; 0 if it has not been */
    int64_t server, server_since; /* subscriber.servers, and when it last changed (ns, monotonic) */
    double began, ended;     /* s, when the task began and ended, by subscriber_time */
    char run[128];           /* NAME/TIME: path in `runs` of the last run's files, without their extensions */
    pid_t scorer;            /* process ID of trocar-score while it runs, otherwise 0 */
    int said;                /* descriptor of an in-memory file with the output of trocar-score */
    bool has_report;
    char message[512];       /* what went wrong, for the page; otherwise "" */
} training;

/* Runs trocar-score, which must be in this program's folder, to read the task. `runs` may be NULL for the default, a folder in the user's home. If the task
   cannot be used, returns BAD_INPUT with trocar-score's message. */
trocar_status training_prepare(training *t, const char *task, const char *runs, trocar_error *why);

/* Subscribes to the messages to record. Call it after subscriber_open. `hand` must outlive `t`, and be open before a task is started. */
trocar_status training_open(training *t, lcm_t *lcm, pilot *hand, trocar_error *why);
void training_close(training *t);

/* Starts the task and its recording. If the tissue contains seeds or tracks of earlier needles, first has the pilot remove them; training_watch then starts the
   recording. Refuses, with a message for the page, if another client holds one of these needles. */
void training_start(training *t, subscriber *feed);

/* Has the tissue cleared, and starts the recording once it is clear. Gives up, with a message for the page, if the server ends, is replaced, or does not clear
   the tissue. Call it after messages have been received, and also while none arrive. */
void training_watch(training *t, subscriber *feed);

/* Ends the task and starts trocar-score. `language` is the report's language, as two ASCII letters with the first in the lowest byte; 0 means English. */
void training_finish(training *t, const subscriber *feed, uint32_t language);

/* Checks whether trocar-score has ended. Does not wait. */
void training_poll(training *t);

/* Calls training_watch and training_poll, then writes the member "task" of the page's status: state, elapsed time (s), whether starting first clears the tissue,
   the report's path without its extension, and the message. */
void training_write(training *t, subscriber *feed, json *j);

#endif
