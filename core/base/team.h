/* Threads that share the iterations of a loop. */
#ifndef TROCAR_TEAM_H
#define TROCAR_TEAM_H

typedef struct team team;

/* Creates a team of `members` threads, including the calling one; fewer if the system cannot start them all. Returns NULL for a single thread; all
   functions accept NULL. */
team *team_create(int members);
void team_free(team *t);
int team_members(const team *t);

typedef void team_work(void *context, int i, int member);

/* Calls work(context, i, member) once for each i in [0, count), where `member` is the index of the thread that makes the call; the calling thread is
   member 0. Calls start in ascending order of i. Returns when all of them have returned. Different calls must not write to the same memory. */
void team_run(team *t, int count, team_work *work, void *context);

/* Like team_run, but while the calling thread waits for the others, it calls meanwhile(context) ten times per second. */
void team_run_watched(team *t, int count, team_work *work, void *context, void (*meanwhile)(void *context));

#endif
