#include "unicast/wire.h"

#include <string.h>

#include <nettle/hmac.h>
#include <nettle/memops.h>

_Static_assert(WIRE_TAG == SHA256_DIGEST_SIZE && WIRE_KEY == SHA256_DIGEST_SIZE, "HMAC-SHA256");

void wire_put_number(unsigned char to[8], uint64_t number) {
    for (int i = 7; i >= 0; i--, number >>= 8) to[i] = (unsigned char)number;
}

uint64_t wire_get_number(const unsigned char *from, int width) {
    uint64_t number = 0;
    for (int i = 0; i < width; i++) number = number << 8 | from[i];
    return number;
}

static void hmac(const void *key, size_t key_size, const void *data, size_t size, unsigned char tag[WIRE_TAG]) {
    struct hmac_sha256_ctx context;
    hmac_sha256_set_key(&context, key_size, key);
    hmac_sha256_update(&context, size, data);
    hmac_sha256_digest(&context, WIRE_TAG, tag);
}

void wire_tag(const wire_key *key, const void *data, size_t size, unsigned char tag[WIRE_TAG]) { hmac(key->bytes, WIRE_KEY, data, size, tag); }

wire_key wire_secret_key(const void *secret, size_t size) {
    static const char protocol[] = "trocar unicast 1";
    wire_key key;
    hmac(protocol, sizeof protocol - 1, secret, size, key.bytes);
    return key;
}

wire_key wire_direction_key(const wire_key *secret, wire_kind kind, const unsigned char nonce[WIRE_NONCE], const unsigned char token[WIRE_TOKEN]) {
    enum { NAME = 9 };
    unsigned char text[NAME + WIRE_NONCE + WIRE_TOKEN];
    wire_key key;
    memcpy(text, kind == WIRE_TO_SERVER ? "to server" : "to client", NAME);
    memcpy(text + NAME, nonce, WIRE_NONCE);
    memcpy(text + NAME + WIRE_NONCE, token, WIRE_TOKEN);
    wire_tag(secret, text, sizeof text, key.bytes);
    return key;
}

int wire_kind_of(const void *datagram, size_t size) {
    const unsigned char *d = datagram;
    if (size < WIRE_HEAD || memcmp(d, "TU1", 3) != 0 || d[3] < WIRE_HELLO || d[3] > WIRE_TO_CLIENT) return 0;
    bool message = d[3] >= WIRE_TO_SERVER;
    bool possible = message ? size >= WIRE_HEAD + 8 + 1 + WIRE_TAG && size <= WIRE_MOST : size == WIRE_HANDSHAKE;
    return possible ? d[3] : 0;
}

bool wire_is_authentic(const wire_key *key, const void *datagram, size_t size) {
    unsigned char tag[WIRE_TAG];
    if (size < WIRE_TAG) return false;
    wire_tag(key, datagram, size - WIRE_TAG, tag);
    return memeql_sec(tag, (const unsigned char *)datagram + size - WIRE_TAG, WIRE_TAG) != 0;
}

static void put_head(unsigned char *to, wire_kind kind) {
    memcpy(to, "TU1", 3);
    to[3] = (unsigned char)kind;
}

size_t wire_put_handshake(unsigned char to[WIRE_HANDSHAKE], wire_kind kind, const wire_handshake *h, const wire_key *key) {
    put_head(to, kind);
    memcpy(to + WIRE_HEAD, h->nonce, WIRE_NONCE);
    memcpy(to + WIRE_HEAD + WIRE_NONCE, h->token, WIRE_TOKEN);
    memset(to + WIRE_HANDSHAKE - WIRE_TAG, 0, WIRE_TAG);
    if (key != NULL) wire_tag(key, to, WIRE_HANDSHAKE - WIRE_TAG, to + WIRE_HANDSHAKE - WIRE_TAG);
    return WIRE_HANDSHAKE;
}

size_t wire_put_message(unsigned char to[WIRE_MOST], wire_kind kind, uint64_t counter, const char *channel, const void *bytes, size_t size,
                        const wire_key *key) {
    unsigned char *at = to + WIRE_HEAD + 8;
    size_t name = strlen(channel) + 1;
    put_head(to, kind);
    wire_put_number(to + WIRE_HEAD, counter);
    memcpy(at, channel, name);
    if (size > 0) memcpy(at + name, bytes, size);
    at += name + size;
    wire_tag(key, to, (size_t)(at - to), at);
    return (size_t)(at - to) + WIRE_TAG;
}

wire_handshake wire_get_handshake(const void *datagram) {
    const unsigned char *d = datagram;
    wire_handshake h;
    memcpy(h.nonce, d + WIRE_HEAD, WIRE_NONCE);
    memcpy(h.token, d + WIRE_HEAD + WIRE_NONCE, WIRE_TOKEN);
    return h;
}

bool wire_get_message(const void *datagram, size_t size, wire_message *m) {
    const unsigned char *d = datagram, *channel = d + WIRE_HEAD + 8, *end = d + size - WIRE_TAG;
    size_t room = (size_t)(end - channel);
    const unsigned char *zero = memchr(channel, 0, room < WIRE_CHANNEL_MOST + 1 ? room : WIRE_CHANNEL_MOST + 1);
    if (zero == NULL) return false;
    *m = (wire_message){.counter = wire_get_number(d + WIRE_HEAD, 8), .channel = (const char *)channel, .bytes = zero + 1, .size = (size_t)(end - zero - 1)};
    return true;
}

bool wire_window_accepts(wire_window *w, uint64_t counter) {
    if (counter > w->newest) {
        uint64_t ahead = counter - w->newest;
        w->seen = (ahead < 64 ? w->seen << ahead : 0) | 1;
        w->newest = counter;
        return true;
    }
    uint64_t behind = w->newest - counter;
    if (counter == 0 || behind >= 64 || (w->seen >> behind & 1)) return false;
    w->seen |= (uint64_t)1 << behind;
    return true;
}
