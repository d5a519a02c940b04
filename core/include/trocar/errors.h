/* Version, errors, and callbacks for long calls. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_ERRORS_H
#define TROCAR_PUBLIC_ERRORS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define TROCAR_API __attribute__((visibility("default")))
#else
#define TROCAR_API
#endif

/* ---- version ---- */

#define TROCAR_MAJOR 0
#define TROCAR_MINOR 2
#define TROCAR_PATCH 0
#define TROCAR_NUMBER (10000 * TROCAR_MAJOR + 100 * TROCAR_MINOR + TROCAR_PATCH)

/* Returns the TROCAR_NUMBER of the loaded library; compare it with the header's. While the major version is 0, every ABI change increments the minor
   version. [any, RT] */
TROCAR_API int trocar_version(void);

/* ---- errors ---- */

typedef enum trocar_status {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, argument or file is invalid; programs exit with status 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a linear solve failed */
    TROCAR_SYSTEM,     /* a system call failed */
    TROCAR_NO_REALTIME, /* used only by programs: the process's resource limits do not permit real-time operation; exit status 4 */
    TROCAR_CANCELLED   /* the host cancelled a long call (trocar_watch) */
} trocar_status;

typedef struct trocar_error {
    char text[1024];
} trocar_error;

/* ---- callbacks ---- */

/* Lets the caller follow and cancel a long call. Both functions are called in the calling thread; either may be NULL. */
typedef struct trocar_watch {
    void (*progress)(const char *what, double fraction, void *context); /* `fraction`: from 0 to 1 */
    int (*cancelled)(void *context);   /* return nonzero to make the call stop soon and return CANCELLED */
    void *context;
} trocar_watch;

typedef enum trocar_log_level {
    TROCAR_LOG_INFO = 0,     /* a choice made by the library, such as which inverse to use */
    TROCAR_LOG_WARNING = 1   /* something the host should check, such as a repaired mesh or a restarted insertion */
} trocar_log_level;

/* Receives messages that a program would print, one sentence each. `write`, which may be NULL, is called in the thread that called the library, so it may
   be called from several threads at once. RT functions never log. */
typedef struct trocar_log {
    void (*write)(int32_t level, const char *message, void *context); /* level: trocar_log_level; more levels may be added in future versions */
    void *context;
} trocar_log;

#ifdef __cplusplus
}
#endif
#endif
