#define _GNU_SOURCE
#include "lcm_filter.h"

#include <netinet/in.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

/* A packet, big-endian. In one piece: magic, sequence number (4 each), channel name with its zero, message. A fragment: magic,
   sequence number, size of the message, offset in it (4 each), number of this fragment, number of fragments (2 each), in
   fragment 0 the channel name with its zero, then its part of the message. */
enum { WHOLE_HEADER = 8, FRAGMENT_HEADER = 20, CHANNEL_MAX = 63, PAYLOAD_MAX = 65507 };
static const uint32_t MAGIC_WHOLE = 0x4c433032, MAGIC_FRAGMENT = 0x4c433033; /* LC02, LC03 */
static const uint32_t MESSAGE_MAX = 1 << 24; /* bytes, as much as liblcm keeps of unfinished messages; 1.4 million nodes */
static const char *const SELF_TEST = "LCM_SELF_TEST"; /* liblcm sends it to itself when it starts to receive */

static uint32_t big_endian_32(const unsigned char *b) {
    return (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
}

static uint32_t big_endian_16(const unsigned char *b) { return (uint32_t)b[0] << 8 | b[1]; }

static bool wants(const packet_wishes *wishes, const char *channel) {
    if (wishes->channels == NULL || strcmp(channel, SELF_TEST) == 0) return true;
    for (const char *const *c = wishes->channels; *c != NULL; c++)
        if (strcmp(channel, *c) == 0) return true;
    return false;
}

/* Bytes of the channel name at the start of `text`, with its zero; 0 if it is too long or does not end within `size`. */
static size_t channel_bytes(const char *text, size_t size) {
    size_t length = strnlen(text, size);
    return length < size && length <= CHANNEL_MAX ? length + 1 : 0;
}

static packet_verdict judge_whole(const unsigned char *packet, size_t size, const packet_wishes *wishes) {
    const char *channel = (const char *)packet + WHOLE_HEADER;
    if (size < WHOLE_HEADER || channel_bytes(channel, size - WHOLE_HEADER) == 0) return PACKET_MALFORMED;
    return wants(wishes, channel) ? PACKET_GOOD : PACKET_UNWANTED;
}

/* What liblcm needs in order to stay within its buffers when it copies this part of the message. It starts over when the size of
   the message changes between fragments, so that needs no memory here. */
static packet_verdict judge_fragment(const unsigned char *packet, size_t size, const packet_wishes *wishes) {
    if (size < FRAGMENT_HEADER) return PACKET_MALFORMED;
    uint32_t message = big_endian_32(packet + 8), offset = big_endian_32(packet + 12);
    uint32_t number = big_endian_16(packet + 16), count = big_endian_16(packet + 18);
    const char *channel = (const char *)packet + FRAGMENT_HEADER;
    size_t part = size - FRAGMENT_HEADER, name = number == 0 ? channel_bytes(channel, part) : 0;

    if (message > MESSAGE_MAX || number >= count || (number == 0) != (offset == 0)) return PACKET_MALFORMED;
    if (count > message || (uint64_t)count * PAYLOAD_MAX < message) return PACKET_MALFORMED;
    if (number == 0 && name == 0) return PACKET_MALFORMED;
    part -= name;
    if (part == 0 || (uint64_t)offset + part > message) return PACKET_MALFORMED;
    if (wishes->whole_only || (number == 0 && !wants(wishes, channel))) return PACKET_UNWANTED;
    return PACKET_GOOD;
}

packet_verdict lcm_filter_judge(const void *packet, size_t size, const packet_wishes *wishes) {
    uint32_t magic = size < 4 ? 0 : big_endian_32(packet);
    if (magic == MAGIC_WHOLE) return judge_whole(packet, size, wishes);
    if (magic == MAGIC_FRAGMENT) return judge_fragment(packet, size, wishes);
    return PACKET_GOOD;
}

static const packet_wishes anything = {0};
static _Atomic(const packet_wishes *) current = &anything;
static atomic_int_least64_t dropped;

void lcm_filter_restrict(const packet_wishes *wishes) { atomic_store(&current, wishes); }
int64_t lcm_filter_dropped(void) { return atomic_load_explicit(&dropped, memory_order_relaxed); }

static bool is_udp(int socket) {
    int protocol;
    socklen_t size = sizeof protocol;
    return getsockopt(socket, SOL_SOCKET, SO_PROTOCOL, &protocol, &size) == 0 && protocol == IPPROTO_UDP;
}

/* In place of libc's. Every datagram is judged by itself, whatever is in the buffer behind it. */
ssize_t recvmsg(int socket, struct msghdr *message, int flags) {
    ssize_t size = syscall(SYS_recvmsg, socket, message, flags);
    if (size <= 0 || message->msg_iovlen != 1 || (size_t)size > message->msg_iov->iov_len || (flags & MSG_PEEK) || !is_udp(socket))
        return size;
    packet_verdict verdict = lcm_filter_judge(message->msg_iov->iov_base, (size_t)size, atomic_load(&current));
    if (verdict == PACKET_MALFORMED) atomic_fetch_add_explicit(&dropped, 1, memory_order_relaxed);
    return verdict == PACKET_GOOD ? size : 0;
}
