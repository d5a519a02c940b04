/* Sends what a server reports to a plotting program such as PlotJuggler. Each UDP datagram is one JSON object. Member names include units; "timestamp" is in s
   since the epoch, by the server's clock. */
#ifndef TROCAR_UDP_JSON_H
#define TROCAR_UDP_JSON_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_status_t.h"

typedef struct {
    int64_t sent;            /* us, utime of the last wrench sent */
    int32_t events;          /* events of all wrenches since then */
    int32_t membrane;        /* the last membrane punctured since then; -1 if none */
    int64_t session;         /* the one that sent `position` */
    double position[3];      /* m, of the base */
} udp_needle;

typedef struct {
    char to[300];            /* HOST:PORT, as given */
    int socket;
    int64_t period;          /* us between two wrenches sent for a needle; 0 sends every wrench */
    udp_needle needles[TROCAR_MAX_NEEDLES];
    int64_t count;           /* datagrams sent */
    int error;               /* errno of the last failure, 0 if there was none in the last second; ECONNREFUSED if no program listens */
    int64_t failed;          /* ns, monotonic time of the last failure */
} udp_json;

/* Connects to `to`, given as HOST:PORT; an IPv6 address goes in brackets. Sends at most `rate` wrenches per second for each needle, or all if `rate` is 0.
   Returns BAD_INPUT if `to` is malformed, if the name has no address, or if there is no route to it. */
trocar_status udp_json_open(udp_json *u, const char *to, double rate, trocar_error *why);
void udp_json_close(udp_json *u);

/* Each sends a message, or keeps it for a later datagram. They never block. */
void udp_json_pose(udp_json *u, const trocar_needle_pose_t *pose);
void udp_json_wrench(udp_json *u, const trocar_needle_wrench_t *wrench);
void udp_json_timing(udp_json *u, const trocar_loop_timing_t *timing);
void udp_json_status(udp_json *u, const trocar_status_t *status);

/* Writes a message for the user: how many datagrams have been sent, or the last error. */
void udp_json_describe(const udp_json *u, char *text, size_t size);

#endif
