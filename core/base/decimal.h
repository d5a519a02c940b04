/* Converts numbers to and from text with a decimal point, whatever the host program's locale. These functions neither allocate nor lock. */
#ifndef TROCAR_DECIMAL_H
#define TROCAR_DECIMAL_H

#include <locale.h>
#include <stdarg.h>
#include <stddef.h>

/* Switches the calling thread to the C locale until restore_locale is called. Use it around calls into other libraries. RT */
locale_t use_c_locale(void);
void restore_locale(locale_t before);

/* Equivalent to snprintf, vsnprintf and strtod in the C locale. RT */
__attribute__((format(printf, 3, 4))) int decimal_print(char *text, size_t size, const char *format, ...);
__attribute__((format(printf, 3, 0))) int decimal_vprint(char *text, size_t size, const char *format, va_list arguments);
double decimal_read(const char *text, char **end);

#endif
