/* Error handling. Functions return a status. On failure, they also write a message to a trocar_error that says where the error is (file, line, key) and how
   to fix it. */
#ifndef TROCAR_ERROR_H
#define TROCAR_ERROR_H

#include <stdarg.h>
#include <stdio.h>

#include "base/decimal.h"
#include "trocar.h"

/* Writes the message and returns `status`, so that a caller can return the result directly. */
__attribute__((format(printf, 3, 4)))
static inline trocar_status fail(trocar_error *why, trocar_status status, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
    return status;
}

#endif
