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

/* Returns the TROCAR_NUMBER of the loaded library, to be compared with the header's. While the major version is 0, every change to the binary
   interface increments the minor version. [any, RT] */
TROCAR_API int trocar_version(void);

/* ---- errors ---- */

typedef enum trocar_status {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, argument or file is wrong; programs exit with status 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a linear solve failed */
    TROCAR_SYSTEM,     /* a system call failed */
    TROCAR_NO_REALTIME, /* only from programs: the process's resource limits do not permit real-time operation; exit status 4 */
    TROCAR_CANCELLED   /* the host cancelled a long call (trocar_watch) */
} trocar_status;

typedef struct trocar_error {
    char text[1024];
} trocar_error;

/* ---- callbacks ---- */

/* Progress and cancellation of a long call. Both functions are called in the thread that makes the call, and either may be NULL. */
typedef struct trocar_watch {
    void (*progress)(const char *what, double fraction, void *context); /* `fraction`: from 0 to 1 */
    int (*cancelled)(void *context);   /* returns nonzero to end the call soon, with CANCELLED */
    void *context;
} trocar_watch;

typedef enum trocar_log_level {
    TROCAR_LOG_INFO = 0,     /* a choice that the library has made, such as which inverse to use */
    TROCAR_LOG_WARNING = 1   /* something that the host should check: a repaired mesh, an insertion that was restarted */
} trocar_log_level;

/* Receives the messages that a program would print, one sentence each, in the thread that makes the call; calls in several threads may log at the same
   time. RT functions never log. `write` may be NULL. */
typedef struct trocar_log {
    void (*write)(int32_t level, const char *message, void *context); /* level: trocar_log_level; more levels may be added in future versions */
    void *context;
} trocar_log;

#ifdef __cplusplus
}
#endif
#endif
