/* SPDX-License-Identifier: MIT
   SPDX-FileCopyrightText: 2026 trocar developers

   Connects a haptic device to trocar-server, from C or C++.

       trocar_client *server = trocar_client_open(NULL, NULL, 0);
       for (;;) {                                               the device's loop
           trocar_client_publish(server, position, orientation);
           trocar_client_newest(server, &wrench);
           ...                                                  render wrench.force and wrench.torque
       }

   A separate thread handles the network. The functions marked RT pass it the newest pose and get the newest wrench through shared memory. They
   take no locks, do not allocate and never wait, so you can call them from a real-time loop; publishing makes one system call, to wake the
   client's thread. Call the RT functions from one thread only, that of the device. The other functions may be called from any thread, but not
   concurrently.

   A client holds one needle. If the scene has several, open a client for each and set `needle` in its options.

   The client chooses its session number, follows only one server if it hears two, and discards wrenches for other devices. It also tells the
   server which wrench the hand is feeling, so that the server's virtual coupling can measure the round trip.

   Watchdog: after 20 ms without a wrench, the force drops to zero. When wrenches arrive again, it is ramped up over 0.1 s.

   Limits: whatever arrives, force, torque and their rates of change stay within the limits in the options. LCM has no authentication, so anyone
   on the network can send a wrench; set limits that are safe for your device. Connections to udp://HOST:PORT are authenticated.

   Frames: poses and wrenches are in the scene's world frame, in metres. Quaternions are w, x, y, z. The needle's axis is its local +z, from base
   to tip, and its bevel faces local +y.

   Link with trocar::client (CMake) or trocar-client (pkg-config), or compile trocar_client.c as C99 into your C or C++ program. It needs only
   the operating system, Linux or Windows (link m and pthread; on Windows, ws2_32 and winmm). macOS should work but is untested.

   On Windows, sleeps last a multiple of 16 ms by default, and the server ramps the force to zero if no pose arrives for 10 ms. While a client is
   open, it therefore raises the timer resolution to 1 ms (timeBeginPeriod).

   URLs of the form udp://HOST:PORT need trocar::client_unicast (CMake) or trocar-client-unicast (pkg-config), or trocar_client.c compiled with
   -DTROCAR_CLIENT_UNICAST and linked with nettle (on Windows, bcrypt; on macOS, nothing). */
#ifndef TROCAR_CLIENT_H
#define TROCAR_CLIENT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_client trocar_client;

typedef struct trocar_client_options {
    const char *url;         /* LCM multicast URL, udpm://..., or udp://HOST:PORT of a server run with --listen; NULL selects $LCM_DEFAULT_URL or, if that is
                                not set, LCM's default */
    double watchdog;         /* s without a wrench before the force is set to zero; 0 selects the default, 0.02 */
    /* SCHED_FIFO priority of the client's thread, which must be below that of the device's loop; 0 keeps the caller's scheduling. On Windows, any value but
       0 selects time-critical priority */
    int priority;
    int needle;              /* index of the device's needle in the scene, from 0 */
    double max_force;        /* N, maximum force to render; 0 selects the default, 20; INFINITY disables the limit */
    double max_torque;       /* N m, maximum torque to render; 0 selects the default, 1 */
    double max_force_rate;   /* N/s, maximum rate of change of the force; 0 selects the default, 2000 */
    double max_torque_rate;  /* N m/s, maximum rate of change of the torque; 0 selects the default, 100 */
    int without_force;       /* 1 if the device renders no force, such as a mouse or a tracker; the needle then follows its poses rigidly */
    const char *secret_file; /* file with the secret of a server run with --listen; NULL selects $TROCAR_SECRET_FILE or, if that is not set, no secret */
} trocar_client_options;

/* Returns the options that trocar_client_open uses if it is given none: the defaults listed above. */
trocar_client_options trocar_client_default_options(void);

/* The wrench to render. While no wrenches arrive, all members are zero, except `membrane`, which is -1. */
typedef struct trocar_client_wrench {
    double force[3];         /* N, world frame: force exerted on the hand by the needle's base */
    double torque[3];        /* N m, world frame: torque about the needle's base */
    double depth;            /* m, length of the needle's track in the tissue */
    int64_t tick;            /* server tick in which the wrench was computed */
    int32_t contacts;        /* number of active contact nodes */
    int32_t events;          /* bits of trocar_client_event, for that tick only; to get the events of every tick, subscribe to TROCAR_WRENCH */
    int32_t membrane;        /* index of the membrane punctured in that tick; -1 if none */
    int32_t flags;           /* bits of trocar_client_flag; SATURATED is also set if this client has limited the wrench */
} trocar_client_wrench;

/* begin: generated by scripts/pages/client_messages from lcmtypes/trocar.lcm */
/* Bits of `flags` in a wrench. */
typedef enum trocar_client_flag {
    TROCAR_CLIENT_FLAG_STALE = 1,                    /* no pose has arrived recently: the wrench is held, then ramped to zero */
    TROCAR_CLIENT_FLAG_SATURATED = 2,                /* the force or torque was limited in magnitude or rate */
    TROCAR_CLIENT_FLAG_NOT_REALTIME = 4,             /* the server is running without SCHED_FIFO or without locked memory */
    TROCAR_CLIENT_FLAG_RAMPING = 8,                  /* the wrench is being ramped: the needle is engaging or releasing, or there was a fault */
    TROCAR_CLIENT_FLAG_LATE_WORKER = 16,             /* the worker has not yet computed the compliance around the tip; an older one or an estimate is used */
    TROCAR_CLIENT_FLAG_UNSTABLE = 32,                /* a computed value was not finite: the insertion restarts */
    TROCAR_CLIENT_FLAG_OVERRUN = 64,                 /* too many periods in a row were missed: the wrench is ramped to zero */
    TROCAR_CLIENT_FLAG_ACTIVE = 128,                 /* the hand got more energy than it put in (energy in status_t), or it oscillated and the coupling was softened */
    TROCAR_CLIENT_FLAG_MISSED_GUIDE = 256,           /* the needle has passed a guide outside its holes and is not guided */
    TROCAR_CLIENT_FLAG_OUTSIDE_MODEL = 512,          /* the shaft is pressed sideways into a body, which the model does not cover: do not trust the wrench */
    TROCAR_CLIENT_FLAG_PROBE_STOPPED = 1024          /* tissue stops the ultrasound probe short of its commanded pose: see probe_wrench_t */
} trocar_client_flag;

/* Bits of `events` in a wrench. */
typedef enum trocar_client_event {
    TROCAR_CLIENT_EVENT_TOUCHED = 1,                 /* the tip touched the outer surface */
    TROCAR_CLIENT_EVENT_PUNCTURE = 2,                /* a membrane was punctured: see membrane */
    TROCAR_CLIENT_EVENT_ADDED = 4,                   /* a contact became active */
    TROCAR_CLIENT_EVENT_REMOVED = 8,                 /* a contact slipped off the tip */
    TROCAR_CLIENT_EVENT_EXITED = 16,                 /* the tip left the tissue on the far side */
    TROCAR_CLIENT_EVENT_REENTERED = 32,              /* the tip went back into the tissue after EXITED */
    TROCAR_CLIENT_EVENT_WITHDRAWN = 64,              /* the needle left the tissue where it had entered */
    TROCAR_CLIENT_EVENT_LATE = 128,                  /* same as the LATE_WORKER flag; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_FULL = 256,                  /* there was no free contact slot, or the track has more than 256 layers */
    TROCAR_CLIENT_EVENT_UNSTABLE = 512,              /* same as the UNSTABLE flag */
    TROCAR_CLIENT_EVENT_KEPT = 1024,                 /* obsolete, never set */
    TROCAR_CLIENT_EVENT_MISSED_GUIDE = 2048,         /* same as the MISSED_GUIDE flag; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_OUTSIDE_MODEL = 4096,        /* same as the OUTSIDE_MODEL flag; set in every tick while the condition holds */
    TROCAR_CLIENT_EVENT_TRACK_DROPPED = 8192,        /* the needle's oldest track was dropped to make room for a new one */
    TROCAR_CLIENT_EVENT_INEXACT = 16384              /* the solver did not reach its tolerance, so the wrench may be less accurate */
} trocar_client_event;
/* end: generated by scripts/pages/client_messages */

/* Connects to the network and starts the client's thread. `options` may be NULL. Waits for the network, but not for a server, which may be started
   later. On failure, returns NULL and writes what went wrong and how to fix it to `why`, which has `size` bytes (to stderr if `why` is NULL).
   Allocates memory. */
trocar_client *trocar_client_open(const trocar_client_options *options, char *why, size_t size);

/* Releases the needle, so that another device can take it at once, then disconnects and frees the client. Does nothing if it is NULL. */
void trocar_client_close(trocar_client *client);

/* Sends a pose of the needle's base. If you publish poses faster than the network takes them, only the newest is sent. Returns 1, or 0 if a number is
   not finite, in which case nothing is sent. RT */
int trocar_client_publish(trocar_client *client, const double position[3], const double orientation[4]);

/* Gets the newest wrench; wrenches that arrive out of order are dropped. Returns 1, or 0 with a zero wrench if the watchdog has expired. That happens
   if there is no server, the needle belongs to another device, or the scene has no such needle; trocar-top shows which. RT */
int trocar_client_newest(trocar_client *client, trocar_client_wrench *wrench);

/* State of the connection. Over multicast, it is ANSWERED or UNANSWERED. */
typedef enum trocar_client_state {
    TROCAR_CLIENT_STATE_ANSWERED,     /* wrenches arrive */
    TROCAR_CLIENT_STATE_UNANSWERED,   /* no wrench arrives, as when another client holds the needle */
    TROCAR_CLIENT_STATE_DISCONNECTED, /* the server at udp://HOST:PORT does not answer */
    TROCAR_CLIENT_STATE_REFUSED       /* the server at udp://HOST:PORT refused this client the last time it answered */
} trocar_client_state;

/* Returns the state of the connection. The client keeps trying to connect in every state. If the state is not ANSWERED and `why` is not NULL, writes
   the reason to `why`, which has `size` bytes. RT */
trocar_client_state trocar_client_get_state(trocar_client *client, char *why, size_t size);

/* Commands for the client's needle. A command is sent at once, and the server's reply arrives later: see trocar_client_reply. Only one command may be
   pending: while the previous one is waiting for its reply, the functions do nothing and return 0; otherwise they return 1. RT

       reset       removes the needle and relaxes the tissue; the next pose engages the needle again
       leave       lets go of the needle, which stays in the tissue and template. Stop publishing poses; later, take the needle again or close the
                   client
       take        takes hold of a resting needle. The first pose after the reply is mapped to the pose at which the needle rests; from there, the
                   needle follows the hand's motion
       drop_seeds  drops `count` seeds, 1 to 16, which stay in the tissue as the needle is drawn back. The first seed's distal end is at the tip.
                   `spacing` is the centre-to-centre spacing in m; 0 selects the scene's value
       undo        cancels the seeds that are still in the needle or, if there are none, removes the last seed that the needle left
       clear       as reset, and removes all seeds that the needle left */
int trocar_client_reset(trocar_client *client);
int trocar_client_leave(trocar_client *client);
int trocar_client_take(trocar_client *client);
int trocar_client_drop_seeds(trocar_client *client, int count, double spacing);
int trocar_client_undo(trocar_client *client);
int trocar_client_clear(trocar_client *client);

/* Result of the last command. */
typedef enum trocar_client_answer {
    TROCAR_CLIENT_NONE,      /* no command has been given */
    TROCAR_CLIENT_WAITING,
    TROCAR_CLIENT_DONE,
    TROCAR_CLIENT_REFUSED,   /* the server refused the command and changed nothing */
    TROCAR_CLIENT_UNANSWERED /* no reply within three seconds: there is no server, or the command or the reply was lost */
} trocar_client_answer;

/* Returns the result of the last command. If it is not DONE and `why` is not NULL, writes the reason to `why`, which has `size` bytes. RT */
trocar_client_answer trocar_client_reply(trocar_client *client, char *why, size_t size);

#ifdef __cplusplus
}
#endif
#endif
