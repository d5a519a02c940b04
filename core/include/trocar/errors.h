/* Version, errors, and the callbacks of long calls. Included by trocar.h. */
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

/* TROCAR_NUMBER of the loaded library; compare it with the header's. While the major version is 0, the minor one changes with the binary interface.
   [any, RT] */
TROCAR_API int trocar_version(void);

/* ---- errors ---- */

typedef enum trocar_status {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, argument or file is wrong; programs exit with status 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a solve broke down */
    TROCAR_SYSTEM,     /* the operating system refused something */
    TROCAR_NO_REALTIME, /* of programs: the limits do not permit real time; they exit with status 4 */
    TROCAR_CANCELLED   /* the host asked to end a long call: trocar_watch */
} trocar_status;

typedef struct trocar_error {
    char text[1024];
} trocar_error;

/* ---- callbacks ---- */

/* Progress and cancellation of a long call, in the thread of that call. Both functions may be NULL. */
typedef struct trocar_watch {
    void (*progress)(const char *what, double fraction, void *context); /* 0 to 1 */
    int (*cancelled)(void *context);   /* returns not 0 to end the call soon, with CANCELLED */
    void *context;
} trocar_watch;

typedef enum trocar_log_level {
    TROCAR_LOG_INFO = 0,     /* what was chosen, such as the inverse */
    TROCAR_LOG_WARNING = 1   /* something that the host should look at: a repaired mesh, an insertion that restarted */
} trocar_log_level;

/* Receives what a program would print: one sentence, in the thread of the call that it is about; calls in several threads may log at the same time. RT
   functions never log. `write` may be NULL. */
typedef struct trocar_log {
    void (*write)(int32_t level, const char *message, void *context); /* level: trocar_log_level; more levels may be added */
    void *context;
} trocar_log;

#ifdef __cplusplus
}
#endif
#endif
