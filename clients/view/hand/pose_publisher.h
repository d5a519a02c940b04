/* A thread that drives a needle for a browser: publishes poses at 1 kHz like any other device. The needle stops if no orders arrive, and no poses
   are sent while there is no server. It also moves the ultrasound probe, at 100 Hz; poses of the probe are sent only while it moves, so that
   another client can take over the probe two seconds after it has stopped. */
#ifndef TROCAR_POSE_PUBLISHER_H
#define TROCAR_POSE_PUBLISHER_H

#include <lcm/lcm.h>
#include <stdatomic.h>

#include "base/spsc_ring.h"
#include "shared/rate_control.h"

static const int64_t HANDOVER_PATIENCE = 2000000000; /* ns without an answer after which a hand-over is abandoned */

typedef enum {
    ORDER_TAKE,
    ORDER_STEER,
    ORDER_RESET,
    ORDER_HOLE,              /* moves the needle to `home` in front of a hole of the template; from then on the needle may pass the template only
                                through this hole */
    ORDER_DROP,
    ORDER_UNDO,
    ORDER_LEAVE,             /* leaves the needle to rest; no poses are sent until GO_ON or RELEASE arrives, or for two seconds */
    ORDER_LAY,               /* leaves a needle that nobody holds to rest, so that it can be taken */
    ORDER_GO_ON,             /* tells the thread that the server has handed over the resting needle, or has refused the request to leave the needle */
    ORDER_REMOVE,            /* pulls out a resting needle */
    ORDER_PROBE,
    ORDER_RELEASE,
    ORDER_END
} order_kind;

typedef struct {
    order_kind kind;
    int needle;              /* index of the needle, for TAKE, LAY and REMOVE */
    bool rests;              /* for TAKE: true if the needle rests, so that it must be handed over before poses are sent, as with LEAVE */
    int seeds;               /* for DROP: number of seeds */
    pose home, base;         /* TAKE: the needle's waiting pose outside the tissue, and its initial pose; HOLE: `home` is the pose to which the needle
                                moves, unless the user steers it sideways, turns it or draws it back; PROBE: pose of the probe */
    rate_control_command command;   /* for STEER and PROBE: the commanded speeds */
} publisher_order;

typedef struct {
    lcm_t *lcm;              /* can be shared with other threads, because lcm_publish is thread-safe */
    int64_t session;
    double needle_length;    /* m */
    rate_control_limits limits, probe_limits;
    spsc_ring orders;        /* publisher_order */
    int wake;                /* eventfd */
    _Atomic int64_t heard;   /* ns, monotonic: arrival time of the last wrench */
    atomic_bool approaching; /* true while the needle moves to its home pose; written only by the publisher thread */

    /* the following members are used only by the thread */
    rate_control_state drive;
    rate_control_command command;
    int needle;              /* index of the needle that is held now, or was held last */
    pose home;               /* waiting pose of the needle, outside the tissue */
    bool holding;
    bool has_hole;           /* true if `home` is in front of the hole to which the needle was ordered */
    bool waiting;            /* true while the thread waits for the server: see ORDER_LEAVE */
    int64_t waits_since;     /* ns, monotonic */
    int64_t ordered;         /* ns, monotonic: time of the last order */
    int64_t seq;             /* sequence number of the last pose */
    int64_t command_seq;     /* sequence number of the last command */
    bool probing;            /* the probe is moving */
    rate_control_state probe;
    rate_control_command probe_command;
    int64_t probe_ordered, probe_sent; /* ns, monotonic: time of the last order for the probe, and of the last pose sent for it */
    int64_t probe_seq;
} pose_publisher;

trocar_status publisher_create(pose_publisher *p, lcm_t *lcm, double needle_length, trocar_error *why);
void publisher_free(pose_publisher *p);

/* Gives an order. If the ring is full, the order is dropped; the next one follows soon. Called by the web thread. */
void publisher_tell(pose_publisher *p, const publisher_order *order);

/* Records that a wrench arrived at `now` (ns, monotonic). Orders given earlier are executed before the next pose is sent. Called by the thread that
   gives the orders. */
void publisher_hear(pose_publisher *p, int64_t now);

/* Executes all orders, then advances by `dt` (s) and publishes a pose if the thread owns the needle and a server is running.
   Returns false after ORDER_END. */
bool publisher_round(pose_publisher *p, int64_t now, double dt);

/* Thread function; `context` is a pose_publisher. Releases the needle and returns after ORDER_END. */
void *publisher_run(void *context);

#endif
