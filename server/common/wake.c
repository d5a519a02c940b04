#include "common/wake.h"

#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <unistd.h>

void wake(int eventfd) {
    uint64_t one = 1;
    ssize_t written = write(eventfd, &one, sizeof one); /* fails only if the counter is full, and then the reader is awake anyway */
    (void)written;
}

void wait_for_wake(int eventfd) {
    struct pollfd descriptor = {.fd = eventfd, .events = POLLIN};
    while (poll(&descriptor, 1, -1) < 0 && errno == EINTR) continue;
    uint64_t count;
    ssize_t taken = read(eventfd, &count, sizeof count);
    (void)taken;
}
