/* Parses addresses given on the command line. */
#ifndef TROCAR_HOST_PORT_H
#define TROCAR_HOST_PORT_H

#include <stdbool.h>

/* Splits HOST:PORT. If `standard_port` is not NULL, the text may be just HOST, and the port is then `standard_port`. The port must be 1 to 65535, and an IPv6
   address must be in brackets. Returns false if `text` is malformed. */
bool split_host_port(const char *text, const char *standard_port, char host[256], char port[6]);

#endif
