#define _GNU_SOURCE
#include "lcm_filter.h"

#include <arpa/inet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

/* Packet formats; numbers are big-endian, with their sizes in bytes in parentheses.
   Whole message: magic (4), sequence number (4), NUL-terminated channel name, message.
   Fragment: magic (4), sequence number (4), size of the message (4), offset in the message (4), index of this fragment (2), number of fragments (2), in
   fragment 0 the NUL-terminated channel name, then this fragment's part of the message. */
enum { WHOLE_HEADER = 8, FRAGMENT_HEADER = 20, CHANNEL_MAX = 63, PAYLOAD_MAX = 65507 };
static const uint32_t MAGIC_WHOLE = 0x4c433032, MAGIC_FRAGMENT = 0x4c433033; /* LC02, LC03 */
static const uint32_t MESSAGE_MAX = 1 << 24; /* bytes, liblcm's limit for a fragmented message; enough for 1.4 million nodes */
static const char *const SELF_TEST = "LCM_SELF_TEST"; /* liblcm sends this to itself when it starts receiving */

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

/* Returns the length of the channel name at the start of `text`, including its NUL, or 0 if the name is too long or not terminated within `size` bytes. */
static size_t channel_bytes(const char *text, size_t size) {
    size_t length = strnlen(text, size);
    return length < size && length <= CHANNEL_MAX ? length + 1 : 0;
}

static packet_verdict judge_whole(const unsigned char *packet, size_t size, const packet_wishes *wishes) {
    const char *channel = (const char *)packet + WHOLE_HEADER;
    if (size < WHOLE_HEADER || channel_bytes(channel, size - WHOLE_HEADER) == 0) return PACKET_MALFORMED;
    return wants(wishes, channel) ? PACKET_GOOD : PACKET_UNWANTED;
}

/* Accepts a fragment only if liblcm will stay within its buffers when it copies it. Each fragment can be checked by itself, because liblcm starts over when
   the message size changes between fragments. */
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

/* ---- what this process wants --------------------------------------------------------------------------------------------------- */

static const packet_wishes anything = {0};
static _Atomic(const packet_wishes *) current = &anything;
static atomic_int_least64_t dropped;

void lcm_filter_restrict(const packet_wishes *wishes) { atomic_store(&current, wishes); }
int64_t lcm_filter_dropped(void) { return atomic_load_explicit(&dropped, memory_order_relaxed); }

/* ---- this machine, or another one ---------------------------------------------------------------------------------------- */

static atomic_int_least64_t distant;
static atomic_uint_least32_t newest_distant; /* address of the last sender, in network byte order */
static atomic_uchar kept_local[65536];       /* indexed by port: 1 if only datagrams from this machine are accepted */

int64_t lcm_filter_distant(char *newest, size_t size) {
    int64_t count = atomic_load_explicit(&distant, memory_order_relaxed);
    struct in_addr address = {.s_addr = atomic_load_explicit(&newest_distant, memory_order_relaxed)};
    if (size > 0) newest[0] = '\0';
    if (count > 0 && newest) inet_ntop(AF_INET, &address, newest, (socklen_t)size);
    return count;
}

static const char *url_in_use(const char *url) {
    if (!url || !*url) url = getenv("LCM_DEFAULT_URL");
    return url && *url ? url : "udpm://239.255.76.67:7667?ttl=0"; /* LCM's own default */
}

/* Parses udpm://GROUP:PORT?KEY=VALUE&KEY=VALUE the way liblcm does: numbers may be hexadecimal, and the ttl is truncated to 8 bits. */
bool lcm_filter_is_local(const char *url, uint16_t *port) {
    static const char *const UDPM = "udpm://";
    url = url_in_use(url);
    *port = 0;
    if (strncmp(url, UDPM, strlen(UDPM)) != 0) return false;
    const char *options = url + strcspn(url, "?"), *after_group = url + strlen(UDPM) + strcspn(url + strlen(UDPM), ":?");
    *port = *after_group == ':' ? (uint16_t)strtol(after_group + 1, NULL, 0) : 7667;
    uint8_t ttl = 0;
    for (; *options; options += strcspn(options, "?&"))
        if (strncmp(++options, "ttl=", 4) == 0) ttl = (uint8_t)strtol(options + 4, NULL, 0);
    return ttl == 0;
}

lcm_t *lcm_filter_create(const char *url) {
    uint16_t port;
    bool local = lcm_filter_is_local(url, &port);
    atomic_store(&kept_local[port], local);
    return lcm_create(url);
}

lcm_t *lcm_filter_create_wide(const char *url) {
    enum { LARGEST = 4 << 20 /* bytes */ };
    int most = 0;
    char wide[512];
    FILE *limit = fopen("/proc/sys/net/core/rmem_max", "r");
    if (limit && fscanf(limit, "%d", &most) != 1) most = 0;
    if (limit) fclose(limit);
    url = url_in_use(url);
    if (most <= 0 || strncmp(url, "udpm:", 5) != 0 || strstr(url, "recv_buf_size")) return lcm_filter_create(url);
    int length = snprintf(wide, sizeof wide, "%s%crecv_buf_size=%d", url, strchr(url, '?') ? '&' : '?', most < LARGEST ? most : LARGEST);
    return lcm_filter_create(length < (int)sizeof wide ? wide : url);
}

/* True if one of this machine's interfaces has this address. Any socket will do for `socket`. */
static bool has_interface(int socket, in_addr_t address) {
    struct ifconf all = {0};
    bool found = false;
    if (ioctl(socket, SIOCGIFCONF, &all) != 0 || !(all.ifc_buf = malloc((size_t)all.ifc_len + 1))) return false;
    if (ioctl(socket, SIOCGIFCONF, &all) != 0) all.ifc_len = 0;
    for (const struct ifreq *i = all.ifc_req; i < all.ifc_req + (size_t)all.ifc_len / sizeof *i && !found; i++) {
        struct sockaddr_in own;
        memcpy(&own, &i->ifr_addr, sizeof own);
        found = own.sin_family == AF_INET && own.sin_addr.s_addr == address;
    }
    free(all.ifc_buf);
    return found;
}

/* True if `address` is one of this machine's. Most datagrams come from the same sender, so the last result is cached, but only for a second, because
   interfaces come and go. */
static bool sent_here(int socket, in_addr_t address) {
    static _Thread_local struct {
        in_addr_t address;
        bool here;
        time_t until;
    } last;
    struct timespec now;
    if (address == htonl(INADDR_ANY) || ntohl(address) >> 24 == IN_LOOPBACKNET) return true;
    clock_gettime(CLOCK_MONOTONIC, &now);
    if (last.address == address && now.tv_sec < last.until) return last.here;
    last.address = address;
    last.here = has_interface(socket, address);
    last.until = now.tv_sec + 1;
    return last.here;
}

static uint16_t port_of(int socket) {
    struct sockaddr_in own = {0};
    socklen_t size = sizeof own;
    return getsockname(socket, (struct sockaddr *)&own, &size) == 0 && own.sin_family == AF_INET ? ntohs(own.sin_port) : 0;
}

/* True if the datagram came from another machine. Only IPv4 matters: LCM uses nothing else. */
static bool came_from_afar(int socket, const struct msghdr *message) {
    struct sockaddr_in from;
    if (!message->msg_name || message->msg_namelen < sizeof from) return false;
    memcpy(&from, message->msg_name, sizeof from);
    return from.sin_family == AF_INET && !sent_here(socket, from.sin_addr.s_addr);
}

static void note_distant(const struct msghdr *message) {
    struct sockaddr_in from;
    memcpy(&from, message->msg_name, sizeof from);
    atomic_store_explicit(&newest_distant, from.sin_addr.s_addr, memory_order_relaxed);
    atomic_fetch_add_explicit(&distant, 1, memory_order_relaxed);
}

/* If the packet is a whole message on the channel `origin->channel`, renames the channel to `origin->distant`. */
static void mark_distant(void *packet, size_t size, const packet_origin *origin) {
    if (!origin->channel || size < WHOLE_HEADER || big_endian_32(packet) != MAGIC_WHOLE) return;
    char *channel = (char *)packet + WHOLE_HEADER;
    if (strcmp(channel, origin->channel) == 0) memcpy(channel, origin->distant, strlen(origin->channel));
}

/* ---- libc's recvmsg --------------------------------------------------------------------------------------------------------- */

static bool is_udp(int socket) {
    int protocol;
    socklen_t size = sizeof protocol;
    return getsockopt(socket, SOL_SOCKET, SO_PROTOCOL, &protocol, &size) == 0 && protocol == IPPROTO_UDP;
}

/* Applies the filter to one datagram. Returns the datagram's size, or 0 to drop it. */
static ssize_t filtered(int socket, struct msghdr *message, size_t size) {
    void *packet = message->msg_iov->iov_base;
    const packet_wishes *wishes = atomic_load(&current);
    packet_verdict verdict = lcm_filter_judge(packet, size, wishes);
    if (verdict == PACKET_MALFORMED) atomic_fetch_add_explicit(&dropped, 1, memory_order_relaxed);
    if (verdict != PACKET_GOOD) return 0;
    if (!came_from_afar(socket, message)) return (ssize_t)size;
    if (atomic_load_explicit(&kept_local[port_of(socket)], memory_order_relaxed)) {
        note_distant(message);
        return 0;
    }
    mark_distant(packet, size, &wishes->origin);
    return (ssize_t)size;
}

/* Overrides libc's recvmsg, through which liblcm receives. */
ssize_t recvmsg(int socket, struct msghdr *message, int flags) {
    ssize_t size = syscall(SYS_recvmsg, socket, message, flags);
    if (size <= 0 || message->msg_iovlen != 1 || (size_t)size > message->msg_iov->iov_len || (flags & MSG_PEEK) || !is_udp(socket))
        return size;
    return filtered(socket, message, (size_t)size);
}
