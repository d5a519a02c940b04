/* Connects to the LCM network. */
#ifndef TROCAR_NETWORK_H
#define TROCAR_NETWORK_H

#include <lcm/lcm.h>

#include "base/error.h"

/* Connects to `url`; if it is NULL or empty, to $LCM_DEFAULT_URL or, if that is not set, to LCM's default. BAD_INPUT for a provider that LCM does not
   know, and for mpudpm, whose internal messages liblcm decodes without checks; SYSTEM for temporary errors, such as a missing network route. */
trocar_status network_open(const char *url, lcm_t **opened, trocar_error *why);

#endif
