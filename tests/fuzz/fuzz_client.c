/* Sends several datagrams in a row to the free client. The two bytes before each give its length and its sender. For any input, the wrench to render must
   stay within the limits, and texts must be printable. The client is included as source, so that its static functions can be called. */
#include "fuzz.h"

#include "trocar_client.c"

/* The session and the server named in the seed corpus. */
enum { SESSION = 1 };

static void check(trocar_client *c) {
    trocar_client_wrench w;
    char why[300];
    trocar_client_newest(c, &w);
    REQUIRE(length_of(w.force) <= MAX_FORCE * (1 + 1e-12) && length_of(w.torque) <= MAX_TORQUE * (1 + 1e-12)); /* fails for NaN, too */
    trocar_client_reply(c, why, sizeof why);
    for (const char *t = why; *t != '\0'; t++) REQUIRE(*t >= ' ' && *t <= '~');
    const assembly *a = &c->assembly;
    REQUIRE(a->size <= MESSAGE_MOST && a->count <= FRAGMENTS_MOST && a->missing <= a->count && (size_t)a->filled <= (size_t)a->size * FRAGMENTS_MOST);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static trocar_client *c, *fresh;
    if (c == NULL) {
        c = create_client(&(trocar_client_options){0});
        fresh = create_client(&(trocar_client_options){0});
        REQUIRE(c != NULL && fresh != NULL);
        fresh->session = SESSION;
        fresh->asked = 1;
    }
    memcpy(c, fresh, offsetof(trocar_client, assembly.bytes)); /* copies everything except two buffers */
    while (size >= 3) {
        size_t length = (size_t)data[0] << 8 | data[1];
        const struct sockaddr_in from = {.sin_family = AF_INET, .sin_port = data[2]};
        data += 3, size -= 3;
        if (length > size) length = size;
        unsigned char *datagram = malloc(length + 1); /* a separate allocation, so that reading past its end is detected */
        REQUIRE(datagram != NULL);
        memcpy(datagram + 1, data, length);
        take_datagram(c, datagram + 1, length, &from);
        free(datagram);
        data += length, size -= length;
        check(c);
    }
    return 0;
}
