/* Keeps malformed packets, and packets from other machines, away from liblcm.

   liblcm 1.3.1 (Debian 12) trusts the headers it receives. A single crafted fragment makes it write outside its buffer, and a packet whose
   channel name is not terminated makes it report a 4 GB message. It also binds its socket to all of the machine's addresses, so that with
   ttl=0 in the URL, sent datagrams stay on the machine, but datagrams from other machines still get in.

   Every program linked with trocar::types therefore gets a recvmsg of its own, from lcm_filter.c, which overrides libc's for liblcm too. It
   calls the system's and turns an unwanted datagram into an empty one, which liblcm discards. Wanted datagrams, and those of all sockets
   other than UDP, pass unchanged.

   The override works in executables, but not in plugins loaded at run time. */
#ifndef TROCAR_LCM_FILTER_H
#define TROCAR_LCM_FILTER_H

#include <lcm/lcm.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum {
    PACKET_GOOD,
    PACKET_UNWANTED,         /* well-formed, but not for this program */
    PACKET_MALFORMED,
} packet_verdict;

/* A channel on which local messages must be told apart from others: messages sent by other machines are delivered on the channel `distant` instead. Both
   names have the same length. */
typedef struct {
    const char *channel, *distant;
} packet_origin;

/* The packets that a program wants to receive. */
typedef struct {
    const char *const *channels; /* NULL-terminated. NULL accepts all channels, but liblcm stores the name of each and never frees it */
    bool whole_only;             /* reject fragments, because every wanted message fits in one packet */
    packet_origin origin;        /* both NULL if there is no such channel */
} packet_wishes;

/* Classifies a UDP payload. A payload without LCM's magic number counts as GOOD, because liblcm discards it itself. */
packet_verdict lcm_filter_judge(const void *packet, size_t size, const packet_wishes *wishes);

/* Makes this process receive only the packets in `wishes`, which must stay valid until the process exits. Call it before subscribing. Without it, the
   process receives every well-formed packet. */
void lcm_filter_restrict(const packet_wishes *wishes);

/* Calls lcm_create. If the URL's ttl is 0, as in LCM's default, the process from then on accepts datagrams on that port only if their source is an address
   of this machine. (The kernel drops datagrams from outside that claim such a source.) */
lcm_t *lcm_filter_create(const char *url);

/* Like lcm_filter_create, but asks for the largest receive buffer that the system permits, up to 4 MB, unless the URL sets recv_buf_size. With the default
   buffer, a program that receives deformation_t loses messages on a busy machine, because their packets arrive in bursts. */
lcm_t *lcm_filter_create_wide(const char *url);

/* True if the URL's ttl is 0, that is, if LCM is confined to this machine. Writes the URL's port to `port`. A `url` of NULL or "" means
   $LCM_DEFAULT_URL or, if that is not set, LCM's default. For providers other than udpm, returns false and sets `port` to 0. */
bool lcm_filter_is_local(const char *url, uint16_t *port);

/* Returns how many malformed packets have been dropped since the process started. */
int64_t lcm_filter_dropped(void);

/* Returns how many packets from other machines have been dropped since the process started. Writes the address of the last sender, or "", to `newest`,
   which has `size` bytes. */
int64_t lcm_filter_distant(char *newest, size_t size);

#endif
