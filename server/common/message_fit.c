#include "common/message_fit.h"

#include <stdint.h>

#include "trocar.h"
#include "trocar_status_t.h"

enum { FINGERPRINT = 8 };

/* Returns the value of the length field at this offset, or -1 if it is not a valid length. */
static int64_t length_at(const void *data, size_t size, size_t offset) {
    const unsigned char *b = (const unsigned char *)data + offset;
    if (offset + 4 > size || b[0] > 0x7f) return -1;
    return (int64_t)b[0] << 24 | (int64_t)b[1] << 16 | (int64_t)b[2] << 8 | b[3];
}

bool contacts_fit(const void *data, size_t size) {
    enum { JOINTS = FINGERPRINT + 4 * 8 + 4 * 8 + 8 + 4, JOINT = 3 * 8, CONTACT = 3 * 8 + 3 * 8 + 8 + 1 + 1 };
    int64_t joints = length_at(data, size, JOINTS);
    if (joints < 2 || joints > TROCAR_MAX_JOINTS) return false;
    size_t count_at = JOINTS + 4 + JOINT * (size_t)joints;
    int64_t contacts = length_at(data, size, count_at);
    return contacts >= 0 && contacts <= TROCAR_MAX_POINTS && size == count_at + 4 + CONTACT * (size_t)contacts;
}

bool tracks_fit(const void *data, size_t size) {
    enum { POINTS = FINGERPRINT + 3 * 8 + 4, POINT = 3 * 4 + 4 + 2 + 1 };
    int64_t points = length_at(data, size, POINTS);
    return points >= 0 && points <= TROCAR_MAX_TRACK_POINTS && size == POINTS + 4 + POINT * (size_t)points;
}

bool deformation_fits(const void *data, size_t size, int node_count) {
    enum { NODES = FINGERPRINT + 3 * 8, NODE = 3 * 4 };
    return length_at(data, size, NODES) == node_count && size == NODES + 4 + NODE * (size_t)node_count;
}

bool seeds_fit(const void *data, size_t size) {
    enum { NEEDLES = FINGERPRINT + 3 * 8 + 2 * 8, PENDING = 2, SEED = 4 * 3 * 4 + 4 * 2 };
    int64_t needles = length_at(data, size, NEEDLES);
    if (needles < 0 || needles > TROCAR_MAX_NEEDLES) return false;
    size_t count_at = NEEDLES + 4 + PENDING * (size_t)needles;
    int64_t seeds = length_at(data, size, count_at);
    return seeds >= 0 && seeds <= TROCAR_MAX_SEEDS && size == count_at + 4 + SEED * (size_t)seeds;
}

/* Returns the offset just past the string at this offset, or 0 if the string does not fit or is not terminated. */
static size_t after_string(const void *data, size_t size, size_t offset) {
    int64_t length = length_at(data, size, offset);
    if (length < 1 || (size_t)length > size - offset - 4) return 0;
    offset += 4 + (size_t)length;
    return ((const char *)data)[offset - 1] == '\0' ? offset : 0;
}

bool change_fits(const void *data, size_t size) {
    enum { VALUES = FINGERPRINT + 4 * 8 };
    return after_string(data, size, VALUES) == size;
}

bool values_fit(const void *data, size_t size) {
    enum { COUNT = FINGERPRINT + 2 * 8, VALUE = 8 };
    int64_t count = length_at(data, size, COUNT);
    size_t offset = COUNT + 4;
    if (count < 0 || (size_t)count > size / VALUE) return false;
    for (int64_t i = 0; i < count && offset > 0; i++) offset = after_string(data, size, offset);
    return offset > 0 && offset + VALUE * (size_t)count == size;
}

bool reply_fits(const void *data, size_t size) {
    enum { MESSAGE = FINGERPRINT + 4 * 8 + 3 * 4 };
    int64_t length = length_at(data, size, MESSAGE);
    return length >= 1 && size == MESSAGE + 4 + (size_t)length && ((const char *)data)[size - 1] == '\0';
}

bool status_fits(const void *data, size_t size) {
    enum { STRINGS = 4, AFTER_STRINGS = 3 * 4 + 8 + 4 };
    trocar_status_t empty = {.host = "", .scene = "", .inverse = "", .message = ""};
    /* an empty string is encoded as its length and a zero byte */
    size_t offset = (size_t)trocar_status_t_encoded_size(&empty) - STRINGS * (4 + 1) - AFTER_STRINGS;
    for (int string = 0; string < STRINGS; string++) {
        int64_t length = length_at(data, size, offset);
        if (length < 1 || offset + 4 + (size_t)length > size) return false;
        offset += 4 + (size_t)length;
        if (((const char *)data)[offset - 1] != '\0') return false;
    }
    return offset + AFTER_STRINGS == size;
}
