#include "common/eventfd_signal.h"

#include <errno.h>
#include <poll.h>
#include <stdint.h>
#include <unistd.h>

void eventfd_signal(int eventfd) {
    uint64_t one = 1;
    ssize_t written = write(eventfd, &one, sizeof one); /* fails only if the counter is full, in which case the reader is awake anyway */
    (void)written;
}

void eventfd_wait(int eventfd) {
    struct pollfd descriptor = {.fd = eventfd, .events = POLLIN};
    while (poll(&descriptor, 1, -1) < 0 && errno == EINTR) continue;
    uint64_t count;
    ssize_t taken = read(eventfd, &count, sizeof count);
    (void)taken;
}
