/* The relay thread (--listen). It publishes authentic messages of unicast clients on LCM, where the IO thread, loggers and lcm-spy receive them like any
   others, and sends these clients the IO thread's messages. It runs at a real-time priority below those of the haptic thread and the IO thread, and does a
   bounded amount of work, so a flood of datagrams delays neither of them. */
#ifndef TROCAR_RELAY_H
#define TROCAR_RELAY_H

#include <lcm/lcm.h>
#include <stdio.h>

#include "exchange.h"
#include "unicast/gate.h"

typedef struct {
    exchange *exchange;
    bool realtime;               /* the thread runs under SCHED_FIFO */
    int socket;
    atomic_bool stop;
    lcm_t *lcm;                  /* from here on, used only by the thread while it runs */
    gate gate;
    unsigned char fresh[WIRE_TOKEN]; /* random number for the next client that connects */
    double credit;               /* how many datagrams may be received now */
    int64_t credited;            /* ns, monotonic: when `credit` last changed */
    bool wrong_told;             /* the user has been told that a client has the wrong secret */
    int64_t unpublished, unsent; /* messages from clients that could not be published, and datagrams to clients that could not be sent */
} relay;

/* Binds the socket, connects to LCM, and adds the relay's buffers to the exchange. SYSTEM if the address cannot be used. */
trocar_status relay_create(relay *r, const struct sockaddr_in *address, const wire_key *secret, const char *lcm_url, bool realtime, exchange *x,
                           trocar_error *why);
void relay_free(relay *r);

/* Main function of the thread. `context` is a relay. */
void *relay_run(void *context);

/* Ends the thread once it has sent the messages in the ring. */
void relay_stop(relay *r);

void relay_summarise(const relay *r, FILE *out); /* for use after the run */

#endif
