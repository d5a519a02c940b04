/* Keeps malformed packets, and packets from other machines, away from liblcm.

   liblcm 1.3.1 (Debian 12) trusts the headers it receives: one crafted fragment makes it write outside its buffer, and a packet whose
   channel name has no end makes it report a message of 4 GB. It also binds its socket to every address of the machine: a URL with ttl=0
   keeps sent datagrams on the machine, but lets other machines' datagrams in.

   Every program linked with trocar::types gets its own recvmsg, defined in lcm_filter.c, which replaces libc's for liblcm too. It
   forwards the call, and turns an unwanted datagram into an empty one, which liblcm discards. Wanted datagrams, and those of all other
   sockets, pass unchanged.

   This works in executables, but not in plugins that a program loads at run time. */
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

/* A channel whose messages are told apart by origin: those sent by other machines are delivered on the channel `distant` instead, whose name has the
   same length. */
typedef struct {
    const char *channel, *distant;
} packet_origin;

/* The packets that a program wants to receive. */
typedef struct {
    const char *const *channels; /* NULL-terminated; NULL: all channels, whose names liblcm then stores and never frees */
    bool whole_only;             /* accept no fragments, because every wanted message fits in one packet */
    packet_origin origin;        /* both pointers are NULL if there is no such channel */
} packet_wishes;

/* Judges a UDP payload. A payload without LCM's magic number is also GOOD, because liblcm itself discards it. */
packet_verdict lcm_filter_judge(const void *packet, size_t size, const packet_wishes *wishes);

/* Restricts the packets that this process receives; `wishes` must outlive it. Call it before subscribing. Initially, any well-formed packet is
   received. */
void lcm_filter_restrict(const packet_wishes *wishes);

/* Calls lcm_create. If the ttl of `url` is 0, as in LCM's default, this process then accepts only this machine's datagrams on the URL's port: those
   whose source is an address of one of its interfaces. (The kernel drops datagrams from outside with such a source.) */
lcm_t *lcm_filter_create(const char *url);

/* True if the ttl of this URL is 0, so that LCM is meant for this machine only; `port` receives the URL's port. NULL or "": $LCM_DEFAULT_URL, else
   LCM's default. False and port 0 for providers other than udpm. */
bool lcm_filter_is_local(const char *url, uint16_t *port);

/* Returns the number of malformed packets dropped since the start of the process. */
int64_t lcm_filter_dropped(void);

/* Returns the number of packets from other machines dropped since the start of the process. `newest`, of `size` bytes, receives the address of the
   last sender, or "". */
int64_t lcm_filter_distant(char *newest, size_t size);

#endif
