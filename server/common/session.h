/* Random numbers that identify clients and servers. */
#ifndef TROCAR_SESSION_H
#define TROCAR_SESSION_H

#include <stdint.h>

int64_t session_new(void);   /* returns a random number above 0 */

#endif
