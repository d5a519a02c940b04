/* Error handling: a function returns a status and writes one message into a report. */
#ifndef TROCAR_REPORT_H
#define TROCAR_REPORT_H

#include <stdarg.h>
#include <stdio.h>

#include "base/decimal.h"
#include "trocar.h"

/* The message about the first failure, with place (file, line, key) and remedy. */
typedef trocar_error report;

/* Writes the message and returns `status`, so that a caller can return the result directly. */
__attribute__((format(printf, 3, 4)))
static inline trocar_status fail(report *why, trocar_status status, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
    return status;
}

#endif
