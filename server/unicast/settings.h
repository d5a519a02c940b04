/* The address to listen on for unicast clients, and the secret that they must know. */
#ifndef TROCAR_SETTINGS_H
#define TROCAR_SETTINGS_H

#include <netinet/in.h>

#include "base/error.h"
#include "unicast/wire.h"

/* Parses HOST:PORT. HOST is an IPv4 address of this machine, a name, or empty for all addresses. BAD_INPUT. */
trocar_status settings_address(const char *text, struct sockaddr_in *address, trocar_error *why);

/* Reads the key from the secret file, which must have 32 to 1024 bytes, not counting trailing line ends. BAD_INPUT if it does not, if anyone but the owner has
   access to the file, or if `file` is NULL and other machines can reach the address. */
trocar_status settings_secret(const char *file, const struct sockaddr_in *address, wire_key *key, trocar_error *why);

#endif
