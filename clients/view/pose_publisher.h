/* The thread that drives the needle for a browser: a device like any other, at 1 kHz. The needle stops when no orders come, and
   no poses are sent while no server is heard: nobody would feel where the needle goes. */
#ifndef TROCAR_POSE_PUBLISHER_H
#define TROCAR_POSE_PUBLISHER_H

#include <lcm/lcm.h>
#include <stdatomic.h>

#include "rate_control.h"
#include "base/spsc_ring.h"

typedef enum { ORDER_TAKE, ORDER_STEER, ORDER_RESET, ORDER_RELEASE, ORDER_END } order_kind;

typedef struct {
    order_kind kind;
    pose base;               /* TAKE: where it begins */
    rate_control_command command;   /* STEER */
} publisher_order;

typedef struct {
    lcm_t *lcm;              /* shared: lcm_publish is safe from any thread */
    int64_t session;
    rate_control_limits limits;
    pose home;
    spsc_ring orders;        /* publisher_order */
    int wake;                /* eventfd */
    _Atomic int64_t heard;   /* ns, monotonic: the server's last wrench */

    /* the thread's own */
    rate_control_state drive;
    rate_control_command command;
    bool holding;
    int64_t ordered;         /* ns, monotonic: last order */
    int64_t seq;             /* of the last pose */
} pose_publisher;

trocar_status publisher_create(pose_publisher *p, lcm_t *lcm, pose home, double needle_length, report *why);
void publisher_free(pose_publisher *p);

/* From the web's thread; an order that finds the ring full is dropped (the next one follows). */
void publisher_tell(pose_publisher *p, const publisher_order *order);

/* From the thread that gives the orders: the server's last wrench came at `now` (ns, monotonic). Orders given before are obeyed
   before the next pose is sent. */
void publisher_hear(pose_publisher *p, int64_t now);

/* Takes all orders, then moves by `dt` (s) and publishes if it holds the needle and a server is heard. Returns false after
   ORDER_END. */
bool publisher_round(pose_publisher *p, int64_t now, double dt);

/* Body of the thread; `context` is a pilot. Ends with ORDER_END, having released the needle. */
void *publisher_run(void *context);

#endif
