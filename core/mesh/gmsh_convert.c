#include "mesh/gmsh_convert.h"

#include <dlfcn.h>
#include <errno.h>
#include <locale.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "base/folders.h"

/* ---- the library ---- */

static const char LIBRARY[] = "libgmsh.so.4.8"; /* the version in Debian 12; later versions have a different gmshInitialize */

/* The functions from Gmsh's C interface (gmshc.h) used here. On failure, they set *error to a nonzero value. */
typedef struct {
    void (*start)(int argc, char **argv, int read_config, int *error);
    void (*finish)(int *error);
    void (*merge)(const char *path, int *error);
    void (*write)(const char *path, int *error);
    void (*get_number)(const char *option, double *value, int *error);
    void (*set_number)(const char *option, double value, int *error);
    void (*add_model)(const char *name, int *error);
    void (*remove_model)(int *error);
    void (*get_current)(char **name, int *error);
    void (*set_current)(const char *name, int *error);
    void (*last_error)(char **text, int *error);
    void (*release)(void *);
} gmsh_functions;

static bool find(void *library, const char *name, void *function) {
    void *symbol = dlsym(library, name);
    memcpy(function, &symbol, sizeof symbol);
    return symbol;
}

/* Loads Gmsh and looks up its functions. The library is never unloaded, because it and its dependencies keep global state. */
static bool load(gmsh_functions *g) {
    void *library = dlopen(LIBRARY, RTLD_NOW | RTLD_LOCAL);
    return library && find(library, "gmshInitialize", &g->start) && find(library, "gmshFinalize", &g->finish) && find(library, "gmshMerge", &g->merge) &&
           find(library, "gmshWrite", &g->write) && find(library, "gmshOptionGetNumber", &g->get_number) &&
           find(library, "gmshOptionSetNumber", &g->set_number) && find(library, "gmshModelAdd", &g->add_model) &&
           find(library, "gmshModelRemove", &g->remove_model) && find(library, "gmshModelGetCurrent", &g->get_current) &&
           find(library, "gmshModelSetCurrent", &g->set_current) && find(library, "gmshLoggerGetLastError", &g->last_error) &&
           find(library, "gmshFree", &g->release);
}

/* ---- conversion ---- */

static trocar_status cannot_read(const gmsh_functions *g, const char *path, trocar_error *why) {
    char *reason = NULL;
    int error = 0;
    g->last_error(&reason, &error);
    bool known = error == 0 && reason && *reason;
    fail(why, TROCAR_BAD_INPUT, "%s: Gmsh cannot read this mesh%s%s: export it again, e.g. as .msh", path, known ? ": " : "", known ? reason : "");
    g->release(reason);
    return TROCAR_BAD_INPUT;
}

/* Gmsh options for the conversion: keep all elements, not just those in physical groups, and leave the coordinates unchanged. */
static const struct { const char *name; double value; } OPTIONS[] = {
    {"General.Terminal", 0}, {"Mesh.MshFileVersion", 4.1}, {"Mesh.Binary", 1}, {"Mesh.SaveAll", 1}, {"Mesh.SaveParametric", 0}, {"Mesh.ScalingFactor", 1},
    {"Mesh.PartitionSplitMeshFiles", 0},
};
enum { OPTION_COUNT = sizeof OPTIONS / sizeof *OPTIONS };

/* Reads `path` into a new Gmsh model and writes it to `converted`. Sets *added once the model exists and must be removed. */
static trocar_status convert(const gmsh_functions *g, const char *path, const char *converted, bool *added, trocar_error *why) {
    double before[OPTION_COUNT];
    int error = 0, ignored = 0;
    for (int i = 0; i < OPTION_COUNT; i++) {
        g->get_number(OPTIONS[i].name, &before[i], &ignored);
        g->set_number(OPTIONS[i].name, OPTIONS[i].value, &ignored);
    }
    g->add_model("trocar", &error);
    *added = error == 0;
    if (!error) g->merge(path, &error);
    trocar_status status = error ? cannot_read(g, path, why) : TROCAR_OK;
    if (status == TROCAR_OK) {
        g->write(converted, &error);
        if (error) status = fail(why, TROCAR_SYSTEM, "%s: Gmsh cannot write %s: is there space?", path, converted);
    }
    for (int i = 0; i < OPTION_COUNT; i++) g->set_number(OPTIONS[i].name, before[i], &ignored);
    return status;
}

/* ---- session ---- */

/* Starts Gmsh. Gmsh sets the locale of the whole process, so the host's locale is restored right away. */
static void start(const gmsh_functions *g, int *error) {
    const char *now = setlocale(LC_ALL, NULL);
    char *before = now ? strdup(now) : NULL;
    g->start(0, NULL, 0, error);
    if (before) setlocale(LC_ALL, before);
    free(before);
}

/* Starts Gmsh, converts the file and ends Gmsh. If the host already uses Gmsh, leaves its session running and works in a separate model, which is removed
   afterwards. */
static trocar_status convert_in_session(const gmsh_functions *g, const char *path, const char *converted, trocar_error *why) {
    int error = 0;
    double terminal = -1.0; /* keeps this value if Gmsh has not been initialised */
    g->get_number("General.Terminal", &terminal, &error);
    bool hosted = error == 0 && terminal >= 0.0;
    char *host_model = NULL;
    error = 0;
    if (hosted) g->get_current(&host_model, &error);
    else start(g, &error);
    if (error) return fail(why, TROCAR_SYSTEM, "%s: cannot start Gmsh (error %d)", path, error);
    bool added;
    trocar_status status = convert(g, path, converted, &added, why);
    if (!hosted) {
        g->finish(&error);
        return status;
    }
    if (added) g->remove_model(&error);
    g->set_current(host_model, &error);
    g->release(host_model);
    return status;
}

static pthread_mutex_t session_lock = PTHREAD_MUTEX_INITIALIZER;

/* Makes fork() wait until other threads are done reading meshes. Otherwise, the child would inherit a half-initialised Gmsh and a lock that is never
   released. */
static pthread_once_t forks_watched = PTHREAD_ONCE_INIT;
static void begin_fork(void) { pthread_mutex_lock(&session_lock); }
static void end_fork(void) { pthread_mutex_unlock(&session_lock); }
static void watch_forks(void) { pthread_atfork(begin_fork, end_fork, end_fork); }

static trocar_status convert_alone(const gmsh_functions *g, const char *path, const char *converted, trocar_error *why) {
    pthread_once(&forks_watched, watch_forks);
    pthread_mutex_lock(&session_lock);
    locale_t before = use_c_locale(); /* otherwise Gmsh would read numbers in the host's locale */
    trocar_status status = convert_in_session(g, path, converted, why);
    restore_locale(before);
    pthread_mutex_unlock(&session_lock);
    return status;
}

FILE *gmsh_convert(const char *path, trocar_status *status, trocar_error *why) {
    gmsh_functions g;
    char folder[512], converted[sizeof folder + 16];
    FILE *file = NULL;
    if (!load(&g)) {
        *status = fail(why, TROCAR_BAD_INPUT, "%s: this is no MSH 2.2 or 4.1 file, and Gmsh, which reads other formats, is not installed: "
                       "apt install libgmsh4.8, or convert the mesh where Gmsh is: gmsh -save -format msh41 -o mesh.msh FILE", path);
        return NULL;
    }
    if (!folders_create_temporary("trocar-mesh", folder, sizeof folder)) {
        *status = fail(why, TROCAR_SYSTEM, "%s: cannot make a temporary folder to convert the mesh in: %s: set TMPDIR", path, strerror(errno));
        return NULL;
    }
    snprintf(converted, sizeof converted, "%s/mesh.msh", folder);
    *status = convert_alone(&g, path, converted, why);
    if (*status == TROCAR_OK && !(file = fopen(converted, "rbe"))) *status = fail(why, TROCAR_SYSTEM, "%s: %s: %s", path, converted, strerror(errno));
    folders_remove(folder);
    return file;
}
