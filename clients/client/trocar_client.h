/* SPDX-License-Identifier: MIT
   SPDX-FileCopyrightText: 2026 trocar developers

   Connects a haptic device to trocar-server, from C or C++.

       trocar_client *server = trocar_client_open(NULL, NULL, 0);
       for (;;) {                                               the device's loop
           trocar_client_publish(server, position, orientation);
           trocar_client_newest(server, &wrench);
           ...                                                  render wrench.force and wrench.torque
       }

   A thread of the client handles the network. The functions marked RT exchange the newest pose and the newest wrench with it through memory.
   They take no lock, do not allocate and never wait, so that they can be called from a real-time loop; publishing takes one system call,
   which wakes the client's thread. Call them from one thread only, the device's; the other functions may be called from any thread, one at a
   time.

   A client holds one needle. For a scene with several needles, open a client for each, with `needle` in its options.

   The client chooses a session number, follows one server if two are heard, tells the server which wrench the hand feels
   (from which the server's virtual coupling measures the round trip), and discards wrenches for other devices.

   Watchdog: after 20 ms without a wrench the force is zero. When wrenches arrive again, the force is ramped up over 0.1 s.

   Limits: whatever arrives, force and torque stay below the limits in the options, and so do their rates of change. LCM has no
   authentication, so anyone on the network can send a wrench; set limits that are safe for your device. A URL udp://HOST:PORT is authenticated.

   Frames: the scene's world frame, in metres. Quaternions are w, x, y, z. The needle's axis is its local +z, from base to tip,
   and its bevel faces local +y.

   Link with trocar::client (CMake) or trocar-client (pkg-config), or add trocar_client.c, compiled as C99, to your program in C or C++. It
   needs only the operating system, Linux or Windows (link m and pthread; on Windows ws2_32); macOS should work but is untested.

   URLs of the form udp://HOST:PORT need trocar::client_unicast (CMake) or trocar-client-unicast (pkg-config), or trocar_client.c compiled with
   -DTROCAR_CLIENT_UNICAST and linked with nettle (on Windows bcrypt; on macOS nothing). */
#ifndef TROCAR_CLIENT_H
#define TROCAR_CLIENT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_client trocar_client;

typedef struct trocar_client_options {
    const char *url;         /* LCM URL of UDP multicast, udpm://..., or udp://HOST:PORT of a server with --listen; NULL selects $LCM_DEFAULT_URL or, if
                                that is not set, LCM's default */
    double watchdog;         /* s without a wrench after which the force is set to zero; 0 selects the default, 0.02 */
    /* SCHED_FIFO priority of the client's thread, which must be below that of the device's loop; 0 keeps the caller's scheduling. On Windows, any
       other value selects time-critical priority */
    int priority;
    int needle;              /* index of the device's needle in the scene, from 0 */
    double max_force;        /* N, maximum force to render; 0 selects the default, 20; INFINITY disables the limit */
    double max_torque;       /* N m, maximum torque to render; 0 selects the default, 1 */
    double max_force_rate;   /* N/s, maximum force rate; 0 selects the default, 2000 */
    double max_torque_rate;  /* N m/s, maximum torque rate; 0 selects the default, 100 */
    int without_force;       /* 1 if the client renders no force, like a mouse or a tracker; the needle then follows its poses rigidly */
    const char *secret_file; /* file with the secret of a server with --listen; NULL selects $TROCAR_SECRET_FILE or, if that is not set, no secret */
} trocar_client_options;

/* The options used when none are given: all defaults listed above. */
trocar_client_options trocar_client_default_options(void);

/* The wrench to render. All members are zero while no wrenches arrive. */
typedef struct trocar_client_wrench {
    double force[3];         /* N, world frame: force that the needle's base exerts on the hand */
    double torque[3];        /* N m, world frame: torque about the needle's base */
    double depth;            /* m, length of the needle's track in the tissue */
    int64_t tick;            /* tick of the server in which the wrench was computed */
    int32_t contacts;        /* number of active contact nodes */
    int32_t events;          /* events of that tick only, as bits of trocar_client_event; to receive the events of every tick, subscribe to TROCAR_WRENCH */
    int32_t membrane;        /* index of the membrane punctured in that tick; -1 if none */
    int32_t flags;           /* bits of trocar_client_flag; SATURATED is also set when this client has limited the wrench */
} trocar_client_wrench;

/* begin: generated by scripts/pages/client_messages from lcmtypes/trocar.lcm */
/* Bits of `flags` in a wrench. */
typedef enum trocar_client_flag {
    TROCAR_CLIENT_FLAG_STALE = 1,                    /* no recent pose: the wrench is held, then ramped to zero */
    TROCAR_CLIENT_FLAG_SATURATED = 2,                /* force or torque is limited in magnitude or rate */
    TROCAR_CLIENT_FLAG_NOT_REALTIME = 4,             /* the server runs without SCHED_FIFO or without locked memory */
    TROCAR_CLIENT_FLAG_RAMPING = 8,                  /* the wrench is ramped while engaging, while releasing or after a fault */
    TROCAR_CLIENT_FLAG_LATE_WORKER = 16,             /* the compliance around the tip has not been computed yet; the last snapshot or an estimate is used */
    TROCAR_CLIENT_FLAG_UNSTABLE = 32,                /* a value is not finite: the insertion restarts */
    TROCAR_CLIENT_FLAG_OVERRUN = 64,                 /* too many consecutive periods were missed: the wrench is ramped to zero */
    TROCAR_CLIENT_FLAG_ACTIVE = 128,                 /* the hand received more energy than it supplied (see energy in status_t), or it oscillated and the coupling has been softened */
    TROCAR_CLIENT_FLAG_MISSED_GUIDE = 256,           /* the needle passes a guide outside its holes and is not guided */
    TROCAR_CLIENT_FLAG_OUTSIDE_MODEL = 512,          /* the shaft is pushed into a body from the side, for which the model computes no force: do not trust the wrench */
    TROCAR_CLIENT_FLAG_PROBE_STOPPED = 1024          /* the tissue stops the ultrasound probe short of the commanded pose: see probe_wrench_t */
} trocar_client_flag;

/* Bits of `events` in a wrench. */
typedef enum trocar_client_event {
    TROCAR_CLIENT_EVENT_TOUCHED = 1,                 /* the tip touched the outer surface */
    TROCAR_CLIENT_EVENT_PUNCTURE = 2,                /* a membrane was punctured: see membrane */
    TROCAR_CLIENT_EVENT_ADDED = 4,                   /* a contact became active */
    TROCAR_CLIENT_EVENT_REMOVED = 8,                 /* a contact slipped off the tip */
    TROCAR_CLIENT_EVENT_EXITED = 16,                 /* the tip left the tissue on the far side */
    TROCAR_CLIENT_EVENT_REENTERED = 32,              /* the tip came back into the tissue after EXITED */
    TROCAR_CLIENT_EVENT_WITHDRAWN = 64,              /* the needle left the tissue where it had entered */
    TROCAR_CLIENT_EVENT_LATE = 128,                  /* same meaning as the flag LATE_WORKER; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_FULL = 256,                  /* no free contact slot was left, or the track has more than 256 layers */
    TROCAR_CLIENT_EVENT_UNSTABLE = 512,              /* same meaning as the flag UNSTABLE */
    TROCAR_CLIENT_EVENT_KEPT = 1024,                 /* obsolete, never set */
    TROCAR_CLIENT_EVENT_MISSED_GUIDE = 2048,         /* same meaning as the flag MISSED_GUIDE; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_OUTSIDE_MODEL = 4096,        /* same meaning as the flag OUTSIDE_MODEL; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_TRACK_DROPPED = 8192,        /* there was no room for more tracks: the needle's oldest track has been dropped */
    TROCAR_CLIENT_EVENT_INEXACT = 16384              /* the solver did not reach its tolerance: the error in the wrench may be larger */
} trocar_client_event;
/* end: generated by scripts/pages/client_messages */

/* Connects to the network and starts the client's thread; `options` may be NULL. Waits for the network, but not for a server, which may be started
   later. On failure, returns NULL and writes a message with the remedy to `why`, of `size` bytes (to stderr if `why` is NULL). Allocates memory. */
trocar_client *trocar_client_open(const trocar_client_options *options, char *why, size_t size);

/* Releases the needle, so that another device can take it at once, then disconnects and frees the client. NULL is allowed. */
void trocar_client_close(trocar_client *client);

/* Sends this pose of the needle's base. If poses are published faster than the network accepts them, only the newest one is sent. Returns 1; returns
   0 and sends nothing if a number is not finite. RT */
int trocar_client_publish(trocar_client *client, const double position[3], const double orientation[4]);

/* Gets the newest wrench; wrenches that arrive out of order are dropped. Returns 1; returns 0 and a zero wrench if the watchdog has expired, because
   there is no server, the needle belongs to another device, or the scene has no such needle (trocar-top shows the reason). RT */
int trocar_client_newest(trocar_client *client, trocar_client_wrench *wrench);

/* Commands for the client's needle. Each is sent at once; the server's reply arrives later: see trocar_client_reply. Only one command may be pending:
   while the previous command waits for its reply, the functions do nothing and return 0; otherwise they return 1. RT

       reset       removes the needle and relaxes the tissue; the next pose engages the needle again
       leave       leaves the needle to rest in tissue and template. Stop publishing poses, and close the client or take the needle again
       take        holds a resting needle again: the first pose after the reply corresponds to the needle's resting pose, and the needle
                   follows the hand's motion from there
       drop_seeds  drops `count` seeds, 1 to 16, which stay in the tissue as the needle is drawn back; the first has its distal end at the tip;
                   `spacing` is their centre-to-centre spacing in m; 0 selects the scene's value
       undo        cancels the seeds that are still in the needle; if there are none, removes the last seed that the needle left */
int trocar_client_reset(trocar_client *client);
int trocar_client_leave(trocar_client *client);
int trocar_client_take(trocar_client *client);
int trocar_client_drop_seeds(trocar_client *client, int count, double spacing);
int trocar_client_undo(trocar_client *client);

/* Result of the last command. */
typedef enum trocar_client_answer {
    TROCAR_CLIENT_NONE,      /* no command has been given */
    TROCAR_CLIENT_WAITING,
    TROCAR_CLIENT_DONE,
    TROCAR_CLIENT_REFUSED,   /* the server refused the command and changed nothing */
    TROCAR_CLIENT_UNANSWERED /* no reply within three seconds: there is no server, or the network has lost the command or the reply */
} trocar_client_answer;

/* Returns the result of the last command. If the result is not DONE and `why` is not NULL, writes the reason to `why`, of `size` bytes. RT */
trocar_client_answer trocar_client_reply(trocar_client *client, char *why, size_t size);

#ifdef __cplusplus
}
#endif
#endif
