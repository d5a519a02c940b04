/* Writes messages to the host's log (trocar_log). Do not use it in functions marked RT. */
#ifndef TROCAR_HOST_LOG_H
#define TROCAR_HOST_LOG_H

#include "base/error.h"

/* The message is truncated to the length of a trocar_error. */
__attribute__((format(printf, 3, 4)))
static inline void host_log(const trocar_log *log, trocar_log_level level, const char *format, ...) {
    if (!log->write) return;
    trocar_error message;
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(message.text, sizeof message.text, format, arguments);
    va_end(arguments);
    log->write(level, message.text, log->context);
}

#endif
