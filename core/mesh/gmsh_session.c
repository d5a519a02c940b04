#include "mesh/gmsh_session.h"

#include <gmshc.h>
#include <locale.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

/* Gmsh sets the locale of the whole process; this restores the host's at once. */
static void start_gmsh(int *error) {
    const char *now = setlocale(LC_ALL, NULL);
    char *before = now ? strdup(now) : NULL;
    gmshInitialize(0, NULL, 0, error);
    if (before) setlocale(LC_ALL, before);
    free(before);
}

/* If the host program already uses Gmsh, works in a model of its own, which is removed again. */
static trocar_status run_in_session(const char *name, trocar_status (*work)(void *context), void *context, report *why) {
    int error = 0;
    double terminal = -1.0; /* unchanged if Gmsh is not running */
    gmshOptionGetNumber("General.Terminal", &terminal, &error);
    bool hosted = error == 0 && terminal >= 0.0;
    char *host_model = NULL;
    error = 0;
    if (hosted) gmshModelGetCurrent(&host_model, &error);
    else start_gmsh(&error);
    if (error) return fail(why, TROCAR_SYSTEM, "%s: cannot start Gmsh (error %d)", name, error);
    trocar_status status = work(context);
    if (!hosted) {
        gmshFinalize(&error);
        return status;
    }
    gmshModelRemove(&error);
    gmshModelSetCurrent(host_model, &error);
    gmshOptionSetNumber("General.Terminal", terminal, &error);
    gmshFree(host_model);
    return status;
}

static pthread_mutex_t session_lock = PTHREAD_MUTEX_INITIALIZER;

/* A fork waits until other threads have read their meshes: otherwise the child would inherit a half-initialised Gmsh and a lock that is never
   released. */
static pthread_once_t forks_watched = PTHREAD_ONCE_INIT;
static void begin_fork(void) { pthread_mutex_lock(&session_lock); }
static void end_fork(void) { pthread_mutex_unlock(&session_lock); }
static void watch_forks(void) { pthread_atfork(begin_fork, end_fork, end_fork); }

trocar_status gmsh_session_run(const char *name, trocar_status (*work)(void *context), void *context, report *why) {
    pthread_once(&forks_watched, watch_forks);
    pthread_mutex_lock(&session_lock);
    locale_t before = use_c_locale(); /* Gmsh reads numbers in the host's locale */
    trocar_status status = run_in_session(name, work, context, why);
    restore_locale(before);
    pthread_mutex_unlock(&session_lock);
    return status;
}
