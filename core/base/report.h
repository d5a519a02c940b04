/* One way to fail: a function returns a status and leaves one clear message in a report. */
#ifndef TROCAR_REPORT_H
#define TROCAR_REPORT_H

#include <stdarg.h>
#include <stdio.h>

#include "trocar.h"

/* The message of the first failure: names the place (file, line, key) and the remedy. */
typedef trocar_error report;

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
