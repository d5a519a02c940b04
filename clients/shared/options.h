/* Numbers and addresses on the command line, for argp parsers. */
#ifndef TROCAR_OPTIONS_H
#define TROCAR_OPTIONS_H

#include <argp.h>
#include <stdbool.h>

#include "base/vec.h"

enum { EXIT_BAD_INPUT = 2 };

/* `count` finite numbers separated by commas in `text`; otherwise exits through argp_error. */
void parse_numbers(const struct argp_state *state, const char *option, const char *text, int count, double *numbers);

/* Three of them. */
vec3 parse_vector(const struct argp_state *state, const char *option, const char *text);

/* A whole number, 0 or more. */
int parse_index(const struct argp_state *state, const char *option, const char *text);

/* One finite number in [least, greatest]. */
double parse_number(const struct argp_state *state, const char *option, const char *text, double least, double greatest);

/* One whole number in [least, greatest]. */
int parse_whole(const struct argp_state *state, const char *option, const char *text, int least, int greatest);

/* A number that was read, if it is whole and in [least, greatest]. */
int whole_number(const struct argp_state *state, const char *option, double number, int least, int greatest);

/* Splits HOST:PORT, or HOST if there is a default port (else NULL), into both parts. The port is 1 to 65535; an IPv6 address must be in brackets.
   False if `text` is malformed. */
bool split_host_port(const char *text, const char *standard_port, char host[256], char port[6]);

#endif
