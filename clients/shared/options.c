#include "shared/options.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

void parse_numbers(const struct argp_state *state, const char *option, const char *text, int count, double *numbers) {
    const char *rest = text;
    for (int i = 0; i < count; i++) {
        char *end;
        numbers[i] = strtod(rest, &end);
        if (end == rest || !isfinite(numbers[i]) || *end != (i + 1 < count ? ',' : '\0'))
            argp_error(state, "--%s: '%s': expected %d finite number%s%s", option, text, count, count > 1 ? "s" : "",
                       count > 1 ? " separated by commas" : "");
        rest = end + 1;
    }
}

double parse_number(const struct argp_state *state, const char *option, const char *text, double least, double greatest) {
    double number;
    parse_numbers(state, option, text, 1, &number);
    if (number < least || number > greatest)
        argp_error(state, "--%s: %s: must lie between %g and %g", option, text, least, greatest);
    return number;
}

int parse_index(const struct argp_state *state, const char *option, const char *text) {
    double number = parse_number(state, option, text, 0, INT32_MAX);
    if (number != floor(number)) argp_error(state, "--%s: %s: must be a whole number", option, text);
    return (int)number;
}

int whole_number(const struct argp_state *state, const char *option, double number, int least, int greatest) {
    if (number < least || number > greatest || number != floor(number))
        argp_error(state, "--%s: %g: must be a whole number between %d and %d", option, number, least, greatest);
    return (int)number;
}

int parse_whole(const struct argp_state *state, const char *option, const char *text, int least, int greatest) {
    return whole_number(state, option, parse_number(state, option, text, least, greatest), least, greatest);
}

vec3 parse_vector(const struct argp_state *state, const char *option, const char *text) {
    double n[3];
    parse_numbers(state, option, text, 3, n);
    return v3(n[0], n[1], n[2]);
}
