/* Detects a second server on the same LCM URL by its TROCAR_STATUS messages. These functions don't touch the network or the clock: bytes and arrival times are
   passed in. */
#ifndef TROCAR_OTHER_SERVER_H
#define TROCAR_OTHER_SERVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* State of the detector. Zero-initialise. */
typedef struct {
    int64_t id;                  /* ID of the other server heard last; 0 if none */
    int64_t heard;               /* ns, monotonic: when its last message arrived */
    char host[64], scene[96];    /* its host and scene, truncated */
} other_server;

/* Takes the bytes of a status_t. Ignores invalid messages and those of server `own`, which is this one. */
void other_server_hear(other_server *o, int64_t own, const void *data, size_t size, int64_t now);

/* Returns whether the other server sent a message within the last second. */
bool other_server_present(const other_server *o, int64_t now);

#endif
