/* A thread that drives a needle for a browser: like any other device, it publishes poses at 1 kHz. The needle stops if no orders arrive, and no poses are sent
   while there is no server. The thread also moves the ultrasound probe, at 100 Hz. It sends probe poses only while the probe moves, so that two seconds after
   it has stopped, another client can take over. */
#ifndef TROCAR_POSE_PUBLISHER_H
#define TROCAR_POSE_PUBLISHER_H

#include <lcm/lcm.h>
#include <stdatomic.h>

#include "base/spsc_ring.h"
#include "shared/rate_control.h"

static const int64_t HANDOVER_PATIENCE = 2000000000; /* ns to wait for an answer before giving up a hand-over */

typedef enum {
    ORDER_TAKE,
    ORDER_STEER,
    ORDER_RESET,
    ORDER_HOLE,              /* moves the needle to `home` in front of a hole; from then on, it may pass the template only through this hole */
    ORDER_DROP,
    ORDER_UNDO,
    ORDER_LEAVE,             /* leaves the needle to rest; sends no poses until GO_ON or RELEASE, or for two seconds */
    ORDER_LAY,               /* leaves to rest a needle that nobody holds, so that it can be taken */
    ORDER_GO_ON,             /* the server has handed over the resting needle, or has refused to let it be left */
    ORDER_REMOVE,            /* pulls out a resting needle */
    ORDER_CLEAR,             /* removes a needle and all its seeds from the tissue; a held one starts again at `home` */
    ORDER_PROBE,
    ORDER_RELEASE,
    ORDER_END
} order_kind;

typedef struct {
    order_kind kind;
    int needle;              /* for TAKE, LAY, REMOVE and CLEAR */
    bool rests;              /* for TAKE: the needle is resting and must be handed over before poses are sent, as with LEAVE */
    int seeds;               /* for DROP: how many */
    pose home, base;         /* TAKE: the needle's waiting pose outside the tissue, and its initial pose; HOLE: `home` is where the needle moves unless the user
                                steers it sideways, turns it or draws it back; PROBE: pose of the probe */
    rate_control_command command;   /* for STEER and PROBE: speeds */
} publisher_order;

typedef struct {
    lcm_t *lcm;              /* may be shared with other threads, because lcm_publish is thread-safe */
    int64_t session;
    double needle_length;    /* m */
    rate_control_limits limits, probe_limits;
    spsc_ring orders;        /* publisher_order */
    int wake;                /* eventfd */
    _Atomic int64_t heard;   /* ns, monotonic, when the last wrench arrived */
    atomic_bool approaching; /* true while the needle is moving to `home`; written only by the publisher thread */

    /* used only by the publisher thread */
    rate_control_state drive;
    rate_control_command command;
    int needle;              /* the needle held now, or held last */
    pose home;               /* the needle's waiting pose outside the tissue */
    bool holding;
    bool has_hole;           /* true if `home` is in front of the hole that the needle was sent to */
    bool waiting;            /* true while waiting for the server: see ORDER_LEAVE */
    int64_t waits_since;     /* ns, monotonic */
    int64_t ordered;         /* ns, monotonic, when the last order came */
    int64_t seq;             /* of the last pose */
    int64_t command_seq;     /* of the last command */
    bool probing;            /* the probe is moving */
    rate_control_state probe;
    rate_control_command probe_command;
    int64_t probe_ordered, probe_sent; /* ns, monotonic, when the last order for the probe came, and when its pose was last sent */
    int64_t probe_seq;
} pose_publisher;

trocar_status publisher_create(pose_publisher *p, lcm_t *lcm, double needle_length, trocar_error *why);
void publisher_free(pose_publisher *p);

/* Gives an order. If the ring is full, the order is dropped; another one follows soon. Called by the web thread. */
void publisher_tell(pose_publisher *p, const publisher_order *order);

/* Records that a wrench arrived at `now` (ns, monotonic). Orders given before are executed before the next pose is sent. Called by the thread that gives the
   orders. */
void publisher_hear(pose_publisher *p, int64_t now);

/* Executes the pending orders, then advances by `dt` (s) and, if the thread holds a needle and a server is running, publishes a pose. Returns false after
   ORDER_END. */
bool publisher_round(pose_publisher *p, int64_t now, double dt);

/* Main function of the thread; `context` is a pose_publisher. After ORDER_END, releases the needle and returns. */
void *publisher_run(void *context);

#endif
