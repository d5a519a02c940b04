#include "base/team.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <time.h>

typedef struct {
    team *team;
    int number;
    pthread_t thread;
} member;

struct team {
    int members;             /* number of threads, including the calling thread, which is member 0 */
    pthread_mutex_t lock;
    pthread_cond_t begun, ended;
    unsigned round;          /* number of parallel loops started so far */
    int busy;                /* number of members, not counting the calling thread, that are still working on this round */
    bool over;
    team_work *work;
    void *context;
    int count;
    atomic_int next;         /* lowest i that no member has started yet */
    member others[];         /* members - 1 entries */
};

static void take_part(team *t, int number) {
    for (int i; (i = atomic_fetch_add(&t->next, 1)) < t->count;) t->work(t->context, i, number);
}

static void *run(void *context) {
    member *self = context;
    team *t = self->team;
    unsigned seen = 0;
    pthread_mutex_lock(&t->lock);
    for (;;) {
        while (t->round == seen && !t->over) pthread_cond_wait(&t->begun, &t->lock);
        if (t->over) break;
        seen = t->round;
        pthread_mutex_unlock(&t->lock);
        take_part(t, self->number);
        pthread_mutex_lock(&t->lock);
        if (--t->busy == 0) pthread_cond_signal(&t->ended);
    }
    pthread_mutex_unlock(&t->lock);
    return NULL;
}

team *team_create(int members) {
    team *t = members > 1 ? calloc(1, sizeof *t + (size_t)(members - 1) * sizeof *t->others) : NULL;
    if (!t) return NULL;
    pthread_mutex_init(&t->lock, NULL);
    pthread_cond_init(&t->begun, NULL);
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&t->ended, &monotonic);
    pthread_condattr_destroy(&monotonic);
    for (t->members = 1; t->members < members; t->members++) {
        member *other = &t->others[t->members - 1];
        *other = (member){.team = t, .number = t->members};
        if (pthread_create(&other->thread, NULL, run, other) != 0) break;
    }
    if (t->members > 1) return t;
    team_free(t);
    return NULL;
}

void team_free(team *t) {
    if (!t) return;
    pthread_mutex_lock(&t->lock);
    t->over = true;
    pthread_cond_broadcast(&t->begun);
    pthread_mutex_unlock(&t->lock);
    for (int i = 0; i < t->members - 1; i++) pthread_join(t->others[i].thread, NULL);
    pthread_cond_destroy(&t->begun);
    pthread_cond_destroy(&t->ended);
    pthread_mutex_destroy(&t->lock);
    free(t);
}

int team_members(const team *t) { return t ? t->members : 1; }

void team_run(team *t, int count, team_work *work, void *context) { team_run_watched(t, count, work, context, NULL); }

static struct timespec a_tenth_of_a_second_from_now(void) {
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    at.tv_nsec += 100000000;
    if (at.tv_nsec >= 1000000000) at = (struct timespec){at.tv_sec + 1, at.tv_nsec - 1000000000};
    return at;
}

static void wait_for_others(team *t, void *context, void (*meanwhile)(void *context)) {
    pthread_mutex_lock(&t->lock);
    while (t->busy > 0) {
        if (!meanwhile) {
            pthread_cond_wait(&t->ended, &t->lock);
            continue;
        }
        struct timespec until = a_tenth_of_a_second_from_now();
        pthread_cond_timedwait(&t->ended, &t->lock, &until);
        pthread_mutex_unlock(&t->lock);
        meanwhile(context);
        pthread_mutex_lock(&t->lock);
    }
    pthread_mutex_unlock(&t->lock);
}

void team_run_watched(team *t, int count, team_work *work, void *context, void (*meanwhile)(void *context)) {
    if (!t || count < 2) {
        for (int i = 0; i < count; i++) work(context, i, 0);
        return;
    }
    pthread_mutex_lock(&t->lock);
    t->work = work;
    t->context = context;
    t->count = count;
    atomic_store(&t->next, 0);
    t->busy = t->members - 1;
    t->round++;
    pthread_cond_broadcast(&t->begun);
    pthread_mutex_unlock(&t->lock);
    take_part(t, 0);
    wait_for_others(t, context, meanwhile);
}
