/* Notices a second server on the same LCM URL by the TROCAR_STATUS that it sends. No network, no clock: bytes and arrival times
   are arguments. */
#ifndef TROCAR_OTHER_SERVER_H
#define TROCAR_OTHER_SERVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* All zero at the start. */
typedef struct {
    int64_t id;                  /* of the last one heard, 0: none yet */
    int64_t heard;               /* ns, monotonic: when */
    char host[64], scene[96];    /* its own words, cut to fit */
} other_server;

/* Takes the bytes of a status_t; those of server `own` and what is no status are passed over. */
void other_server_hear(other_server *o, int64_t own, const void *data, size_t size, int64_t now);

/* Was it heard within the last second? */
bool other_server_present(const other_server *o, int64_t now);

#endif
