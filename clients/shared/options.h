/* Parses numbers and addresses on the command line, for use in argp parsers. On bad input, the functions exit through argp_error. */
#ifndef TROCAR_OPTIONS_H
#define TROCAR_OPTIONS_H

#include <argp.h>
#include <stdbool.h>

#include "base/vec.h"

enum { EXIT_BAD_INPUT = 2 };

/* Parses `count` finite numbers in `text`, separated by commas. */
void parse_numbers(const struct argp_state *state, const char *option, const char *text, int count, double *numbers);

/* Parses three finite numbers. */
vec3 parse_vector(const struct argp_state *state, const char *option, const char *text);

/* Parses a whole number, 0 or more. */
int parse_index(const struct argp_state *state, const char *option, const char *text);

/* Parses one finite number in [least, greatest]. */
double parse_number(const struct argp_state *state, const char *option, const char *text, double least, double greatest);

/* Parses one whole number in [least, greatest]. */
int parse_whole(const struct argp_state *state, const char *option, const char *text, int least, int greatest);

/* Converts a parsed number to an int. It must be whole and in [least, greatest]. */
int whole_number(const struct argp_state *state, const char *option, double number, int least, int greatest);

#endif
