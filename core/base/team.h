/* Threads that share a loop. */
#ifndef TROCAR_TEAM_H
#define TROCAR_TEAM_H

typedef struct team team;

/* `members` threads with the calling one; fewer if the system has no more. NULL if that is one: all functions take it. */
team *team_create(int members);
void team_free(team *t);
int team_members(const team *t);

/* Calls work(context, i, member) once for each i in [0, count), by any member, smaller i first; returns when all calls have. What one call
   writes no other may touch. The calling thread is member 0. */
void team_run(team *t, int count, void (*work)(void *context, int i, int member), void *context);

#endif
