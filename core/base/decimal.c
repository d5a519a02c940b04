#include "base/decimal.h"

#include <stdio.h>
#include <stdlib.h>

/* newlocale("C") returns a static object of the C library, so nothing is allocated and there is nothing to free. */
locale_t use_c_locale(void) { return uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0)); }

void restore_locale(locale_t before) { uselocale(before); }

int decimal_vprint(char *text, size_t size, const char *format, va_list arguments) {
    locale_t before = use_c_locale();
    int length = vsnprintf(text, size, format, arguments);
    restore_locale(before);
    return length;
}

int decimal_print(char *text, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    int length = decimal_vprint(text, size, format, arguments);
    va_end(arguments);
    return length;
}

double decimal_read(const char *text, char **end) {
    locale_t before = use_c_locale();
    double number = strtod(text, end);
    restore_locale(before);
    return number;
}
