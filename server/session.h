/* A number at random by which one client, or one server, is told from the others. */
#ifndef TROCAR_SESSION_H
#define TROCAR_SESSION_H

#include <stdint.h>

int64_t session_new(void);   /* at random, above 0 */

#endif
