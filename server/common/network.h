/* Connects to the LCM network. */
#ifndef TROCAR_NETWORK_H
#define TROCAR_NETWORK_H

#include <lcm/lcm.h>

#include "base/error.h"

/* Connects to `url`. If that is NULL or empty, connects to $LCM_DEFAULT_URL or, if that is not set either, to LCM's default. BAD_INPUT for a provider unknown
   to LCM, and for mpudpm, because liblcm decodes its internal messages without checks. SYSTEM for errors that may be temporary, such as a missing network
   route. */
trocar_status network_open(const char *url, lcm_t **opened, trocar_error *why);

#endif
