/* The address on which the server listens for unicast clients, and the secret that they must know. */
#ifndef TROCAR_SETTINGS_H
#define TROCAR_SETTINGS_H

#include <netinet/in.h>

#include "base/error.h"
#include "unicast/wire.h"

/* Reads HOST:PORT, where HOST is an IPv4 address of this machine, a name, or empty for all addresses. BAD_INPUT. */
trocar_status settings_address(const char *text, struct sockaddr_in *address, trocar_error *why);

/* Reads the key from the secret file, which must contain 32 to 1024 bytes, not counting trailing line ends. BAD_INPUT otherwise, if users other than the
   owner have access to the file, or if `file` is NULL and the address can be reached from other machines. */
trocar_status settings_secret(const char *file, const struct sockaddr_in *address, wire_key *key, trocar_error *why);

#endif
