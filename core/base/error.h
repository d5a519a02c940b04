/* Error handling: a function returns a status. On failure, it also writes a message into a trocar_error, which says where the error is (file, line, key) and
   how to correct it. */
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
