/* Addresses on the command line. */
#ifndef TROCAR_HOST_PORT_H
#define TROCAR_HOST_PORT_H

#include <stdbool.h>

/* Splits HOST:PORT, or HOST if `standard_port` is not NULL, into its parts. The port is 1 to 65535; an IPv6 address must be in brackets. False if
   `text` is malformed. */
bool split_host_port(const char *text, const char *standard_port, char host[256], char port[6]);

#endif
