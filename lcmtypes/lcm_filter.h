/* Keeps malformed packets away from liblcm.

   liblcm 1.3.1 (Debian 12) trusts the headers it receives: one crafted fragment makes it write outside of its buffer, and a packet whose
   channel name has no end makes it report a message of 4 GB. Every program that is linked with trocar::types has a recvmsg of its
   own, in lcm_filter.c, which takes the place of libc's for liblcm too. It forwards the call, and turns a datagram that claims
   to be LCM's but does not add up into an empty one, which liblcm discards. All other sockets and datagrams pass unchanged.

   This works in executables, not in plugins that a program loads at run time. */
#ifndef TROCAR_LCM_FILTER_H
#define TROCAR_LCM_FILTER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum {
    PACKET_GOOD,
    PACKET_UNWANTED,         /* well-formed, but not for this program */
    PACKET_MALFORMED,
} packet_verdict;

/* What a program wants to receive. */
typedef struct {
    const char *const *channels; /* NULL-terminated; NULL: any. liblcm remembers every channel name it has seen, for good */
    bool whole_only;             /* no fragments: every message it wants fits in one packet */
} packet_wishes;

/* Judges a UDP payload. GOOD also if it does not carry LCM's magic number: liblcm itself discards those. */
packet_verdict lcm_filter_judge(const void *packet, size_t size, const packet_wishes *wishes);

/* Restricts what this process receives; `wishes` must outlive it. Call it before subscribing. Initially any well-formed packet. */
void lcm_filter_restrict(const packet_wishes *wishes);

/* Malformed packets dropped since the start of the process. */
int64_t lcm_filter_dropped(void);

#endif
