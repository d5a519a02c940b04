/* Parses numbers and addresses from the command line, for use in argp parsers. */
#ifndef TROCAR_OPTIONS_H
#define TROCAR_OPTIONS_H

#include <argp.h>
#include <stdbool.h>

#include "base/vec.h"

enum { EXIT_BAD_INPUT = 2 };

/* Parses `count` finite numbers separated by commas in `text`; if that fails, exits through argp_error. */
void parse_numbers(const struct argp_state *state, const char *option, const char *text, int count, double *numbers);

/* Parses three finite numbers. */
vec3 parse_vector(const struct argp_state *state, const char *option, const char *text);

/* Parses a whole number, 0 or more. */
int parse_index(const struct argp_state *state, const char *option, const char *text);

/* Parses one finite number in [least, greatest]. */
double parse_number(const struct argp_state *state, const char *option, const char *text, double least, double greatest);

/* Parses one whole number in [least, greatest]. */
int parse_whole(const struct argp_state *state, const char *option, const char *text, int least, int greatest);

/* Returns a parsed number as an int if it is whole and in [least, greatest]; otherwise exits. */
int whole_number(const struct argp_state *state, const char *option, double number, int least, int greatest);

#endif
