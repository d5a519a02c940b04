/* The whole server: builds the simulation, owns the buffers and runs the threads. */
#ifndef TROCAR_SERVER_H
#define TROCAR_SERVER_H

#include <stdbool.h>
#include <stdio.h>

#include "base/error.h"

typedef struct {
    const char *scene_path;
    const char *lcm_url;         /* LCM URL; NULL for LCM's default */
    const char *listen;          /* HOST:PORT for unicast clients; NULL for none */
    const char *secret_file;     /* file with the unicast clients' secret; NULL for none, which is allowed only on this machine's loopback address */
    double rate_hz;              /* tick rate; 0 for the scene's */
    bool allow_non_rt;           /* run without locked memory or SCHED_FIFO if need be, and say so in every message */
    bool prepare;                /* factorise the matrix of the whole mesh in the background (trocar_model_prepare) */
    bool verbose;                /* print a line of timing per second on stderr */
} server_options;

typedef struct server server;

/* Reads the scene and builds everything, but starts no threads. BAD_INPUT if the scene, mesh, rate, URL, address or secret is invalid. NO_REALTIME if real-time
   operation is refused and allow_non_rt is not set; the message names the limit to raise. SYSTEM if there is no network yet. The strings in `options` must
   outlive the server. */
trocar_status server_create(const server_options *options, server **created, trocar_error *why);
void server_free(server *s); /* does nothing while the server is busy */

/* Runs until `stop_descriptor` (an eventfd, for example) becomes readable, a client asks for a shutdown, or the network fails. Then ramps the wrench down to
   zero and joins all threads, except one that is factorising a large matrix. If `ready` is not NULL, calls it once the server is listening. */
trocar_status server_run(server *s, int stop_descriptor, void (*ready)(void), trocar_error *why);

/* Returns whether a thread that is factorising a large matrix is still running after server_run has returned. If so, the process must end with _exit. */
bool server_busy(const server *s);

void server_describe(const server *s, FILE *out);       /* prints a paragraph about scene and settings; call it before the run */
void server_summarise(const server *s, FILE *out);      /* prints the timing of the run; call it afterwards */

#endif
