/* Makes insertion.c print how many wrenches its client has accepted. The client is included as source: if the writer's slot has changed when the client asks
   for the next datagram (recvfrom is replaced), it has stored a wrench. */
#include "trocar_client.c"

static long accepted;

ssize_t __real_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length);
ssize_t __wrap_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length);

ssize_t __wrap_recvfrom(int s, void *buffer, size_t size, int flags, struct sockaddr *from, socklen_t *length) {
    static unsigned slot = 1; /* the writer's first slot */
    const trocar_client *c = (const trocar_client *)((const char *)buffer - offsetof(trocar_client, datagram));
    accepted += c->wrench_slots.back != slot;
    slot = c->wrench_slots.back;
    return __real_recvfrom(s, buffer, size, flags, from, length);
}

__attribute__((destructor)) static void print_accepted(void) { printf("accepted %ld\n", accepted); }
