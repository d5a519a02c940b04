/* Checks messages that contain arrays or strings before LCM decodes them, because LCM's generated decoders trust the counts in a message. */
#ifndef TROCAR_MESSAGE_FIT_H
#define TROCAR_MESSAGE_FIT_H

#include <stdbool.h>
#include <stddef.h>

/* Each function returns true if the bytes are exactly one message of its type, with all lengths within `size` and all strings terminated. */
bool contacts_fit(const void *data, size_t size);
bool tracks_fit(const void *data, size_t size);
bool deformation_fits(const void *data, size_t size, int node_count);
bool seeds_fit(const void *data, size_t size);
bool change_fits(const void *data, size_t size);
bool values_fit(const void *data, size_t size);
bool reply_fits(const void *data, size_t size);
bool status_fits(const void *data, size_t size);

#endif
