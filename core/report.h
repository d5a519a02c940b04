/* One way to fail: a function returns a status and leaves one clear message in a report. */
#ifndef TROCAR_REPORT_H
#define TROCAR_REPORT_H

#include <stdarg.h>
#include <stdio.h>

typedef enum {
    TROCAR_OK = 0,
    TROCAR_BAD_INPUT,  /* a scene, mesh, log or option is wrong: `main` exits with 2 */
    TROCAR_NO_MEMORY,  /* an allocation failed */
    TROCAR_NUMERIC,    /* a factorisation or a solve broke down */
    TROCAR_SYSTEM,     /* the operating system refused something */
    TROCAR_NO_REALTIME, /* the limits do not permit real time: `main` exits with 4 */
} trocar_status;

/* The message of the first failure: names the place (file, line, key) and the remedy. */
typedef struct {
    char text[1024];
} report;

/* Writes the message and returns `status`, so that a caller fails in one line. */
__attribute__((format(printf, 3, 4)))
static inline trocar_status fail(report *why, trocar_status status, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
    return status;
}

#endif
