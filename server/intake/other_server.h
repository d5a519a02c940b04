/* Detects a second server on the same LCM URL by its TROCAR_STATUS messages. The code uses no network and no clock: bytes and arrival times are
   arguments. */
#ifndef TROCAR_OTHER_SERVER_H
#define TROCAR_OTHER_SERVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* State of the detector. All zero at the start. */
typedef struct {
    int64_t id;                  /* ID of the most recent other server; 0 if none has been heard */
    int64_t heard;               /* ns, monotonic: arrival time of the other server's last message */
    char host[64], scene[96];    /* the other server's host and scene, truncated */
} other_server;

/* Takes the bytes of a status_t. Ignores invalid messages and those of the server `own`. */
void other_server_hear(other_server *o, int64_t own, const void *data, size_t size, int64_t now);

/* True if the other server sent a message within the last second. */
bool other_server_present(const other_server *o, int64_t now);

#endif
