/* Who a client is to the server: a number of its own, by which all that it sends is told from other clients'. */
#ifndef TROCAR_SESSION_H
#define TROCAR_SESSION_H

#include <stdint.h>

int64_t session_new(void);   /* at random, above 0 */

#endif
