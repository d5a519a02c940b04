#include "tissue/gmsh_session.h"

#include <gmshc.h>
#include <stdbool.h>
#include <threads.h>

/* If the host program already uses Gmsh, the work is done in a model that is removed again. */
static trocar_status run_in_session(const char *name, trocar_status (*work)(void *context), void *context, report *why) {
    int error = 0;
    double terminal = -1.0; /* unchanged if Gmsh is not running */
    gmshOptionGetNumber("General.Terminal", &terminal, &error);
    bool hosted = error == 0 && terminal >= 0.0;
    char *host_model = NULL;
    error = 0;
    if (hosted) gmshModelGetCurrent(&host_model, &error);
    else gmshInitialize(0, NULL, 0, &error);
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

static mtx_t session_lock;
static once_flag session_once = ONCE_FLAG_INIT;
static void create_lock(void) { mtx_init(&session_lock, mtx_plain); }
static mtx_t *gmsh_lock(void) {
    call_once(&session_once, create_lock);
    return &session_lock;
}

trocar_status gmsh_session_run(const char *name, trocar_status (*work)(void *context), void *context, report *why) {
    mtx_lock(gmsh_lock());
    trocar_status status = run_in_session(name, work, context, why);
    mtx_unlock(gmsh_lock());
    return status;
}
