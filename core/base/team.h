/* A team of threads that share the iterations of a loop. */
#ifndef TROCAR_TEAM_H
#define TROCAR_TEAM_H

typedef struct team team;

/* Creates a team of `members` threads, including the calling one; fewer if the system cannot start them all. If that leaves only the calling thread, returns
   NULL, which all functions accept as a team of one. */
team *team_create(int members);
void team_free(team *t);
int team_members(const team *t);

typedef void team_work(void *context, int i, int member);

/* Calls work(context, i, member) once for each i in [0, count), distributing the calls among the team, and returns when all are done. `member` is the index
   of the thread making the call; the calling thread is member 0. Calls start in ascending order of i. They must not write to the same memory. */
void team_run(team *t, int count, team_work *work, void *context);

/* Like team_run, but calls meanwhile(context) ten times per second while the calling thread waits for the others. */
void team_run_watched(team *t, int count, team_work *work, void *context, void (*meanwhile)(void *context));

#endif
