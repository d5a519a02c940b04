/* Sends a server's reports to a plotting program such as PlotJuggler: each UDP datagram is one JSON object. Member names include units; "timestamp"
   is in s since the epoch, on the server's clock. */
#ifndef TROCAR_UDP_JSON_H
#define TROCAR_UDP_JSON_H

#include <stdbool.h>
#include <stdint.h>

#include "base/report.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_status_t.h"

typedef struct {
    int64_t sent;            /* us: utime of the wrench that was sent last */
    int32_t events;          /* events of all wrenches since then */
    int32_t membrane;        /* the last membrane punctured since then; -1: none */
    int64_t session;         /* that has sent `position` */
    double position[3];      /* m, of the base */
} udp_needle;

typedef struct {
    char to[300];            /* HOST:PORT, as given */
    int socket;
    int64_t period;          /* us between two wrenches of a needle; 0: every wrench */
    udp_needle needles[TROCAR_MAX_NEEDLES];
    int64_t count;           /* datagrams sent */
    int error;               /* errno of the last failure, 0: none in the last second. ECONNREFUSED: nobody listens there */
    int64_t failed;          /* ns, monotonic: time of that failure */
} udp_json;

/* `to`: HOST:PORT, with an IPv6 address in brackets. `rate`: wrenches per second and needle at most, 0: all. BAD_INPUT if it is malformed, if the
   name has no address, or if there is no route to it. */
trocar_status udp_json_open(udp_json *u, const char *to, double rate, report *why);
void udp_json_close(udp_json *u);

/* Sends a message, or keeps it for a later datagram. Never waits. */
void udp_json_pose(udp_json *u, const trocar_needle_pose_t *pose);
void udp_json_wrench(udp_json *u, const trocar_needle_wrench_t *wrench);
void udp_json_timing(udp_json *u, const trocar_loop_timing_t *timing);
void udp_json_status(udp_json *u, const trocar_status_t *status);

/* A text on the state of the datagrams, for the user. */
void udp_json_describe(const udp_json *u, char *text, size_t size);

#endif
