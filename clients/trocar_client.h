/* Connects a haptic device to trocar-server, from C or C++.

       trocar_client *server = trocar_client_open(NULL, NULL, 0);
       for (;;) {                                               the device's loop
           trocar_client_publish(server, position, orientation);
           trocar_client_newest(server, &wrench);
           ...                                                  render wrench.force and wrench.torque
       }

   A thread of the client handles the network. The functions marked RT exchange the newest pose and the newest
   wrench with it through memory. They take no lock, do not allocate and never wait, so that they can be called from a
   real-time loop; publishing takes one system call, which wakes the client's thread. Call them from one thread only, the
   device's; the others may be called from any thread, one at a time.

   A client holds one needle. For a scene with several, open a client for each, with `needle` in its options.

   The client chooses a session number, follows one server if two are heard, tells the server which wrench the hand feels
   (its virtual coupling needs the round trip), and discards wrenches for other devices.

   Watchdog: after 20 ms without a wrench the force is zero. When wrenches arrive again, the force is ramped up in 0.1 s.

   Limits: whatever arrives, force and torque stay below the limits in the options and change no faster than these say. LCM has no
   authentication, so that anyone on the network can send a wrench; set what your device bears.

   Frames: the scene's world frame, in metres. Quaternions are w, x, y, z. The needle's axis is its local +z, from base to tip,
   and its bevel faces local +y. Link with trocar::client (CMake) or trocar-client (pkg-config). */
#ifndef TROCAR_CLIENT_H
#define TROCAR_CLIENT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_client trocar_client;

typedef struct trocar_client_options {
    const char *url;         /* LCM URL; NULL: $LCM_DEFAULT_URL, or else LCM's default */
    double watchdog;         /* s without a wrench until the force is zero; 0: 0.02 */
    int priority;            /* SCHED_FIFO priority of the client's thread, below the device's loop; 0: as the caller */
    int needle;              /* index of the device's needle in the scene, from 0 */
    double max_force;        /* N, of the force to render; 0: 20; INFINITY: not limited */
    double max_torque;       /* N m; 0: 1 */
    double max_force_rate;   /* N/s; 0: 2000 */
    double max_torque_rate;  /* N m/s; 0: 100 */
    int without_force;       /* 1: the client renders no force, like a mouse or a tracker; the needle then follows its poses rigidly */
} trocar_client_options;

/* The wrench to render. All zero while no wrenches arrive. */
typedef struct trocar_client_wrench {
    double force[3];         /* N, world frame: of the needle's base on the hand */
    double torque[3];        /* N m, world frame, about the base point */
    double depth;            /* m, length of the needle's track in the tissue */
    int64_t tick;            /* of the server */
    int32_t contacts;        /* active contact nodes */
    int32_t events;          /* of that tick only; subscribe to TROCAR_WRENCH for those of every tick */
    int32_t membrane;        /* punctured in that tick, -1 if none */
    int32_t flags;           /* TROCAR_NEEDLE_WRENCH_T_STALE, ... of trocar_needle_wrench_t.h; SATURATED also when the client has limited it */
} trocar_client_wrench;

/* Connects; `options` may be NULL. Waits for the network, but not for a server, which may start later. Returns NULL and a
   message with the remedy in `why`, of `size` bytes (NULL: the message goes to stderr). Starts a thread and allocates. */
trocar_client *trocar_client_open(const trocar_client_options *options, char *why, size_t size);

/* Releases the needle, so that another device can take it at once, and disconnects. NULL is allowed. */
void trocar_client_close(trocar_client *client);

/* Sends this pose of the needle's base. If poses come faster than the network takes them, only the newest is sent. Returns 0, and
   sends nothing, if a number is not finite. RT */
int trocar_client_publish(trocar_client *client, const double position[3], const double orientation[4]);

/* The newest wrench. Returns 1, or 0 and a zero wrench if the watchdog has expired, because there is no server, the needle
   belongs to another device, or the scene has no such needle (trocar-top shows the reason). RT */
int trocar_client_newest(trocar_client *client, trocar_client_wrench *wrench);

/* Commands for the client's needle. Each is sent at once; the server's reply arrives later: see trocar_client_reply. One command at a time:
   they return 1, or 0, and do nothing, while the previous one waits for its reply. RT

       reset       removes the needle and relaxes the tissue; the next pose engages the needle again
       leave       lets go of the needle: it rests in tissue and template. Stop publishing poses, and close the client or take the needle again
       take        holds a resting needle again, where it is: the first pose after the reply stands for the place where it rests, and the needle
                   follows the hand's motion from there
       drop_seeds  leaves `count` seeds, 1 to 16, of which the first has its distal end at the tip, as the needle is drawn back over them;
                   `spacing`, between their centres, is in m, 0: the scene's
       undo        cancels the seeds that are still in the needle; if there are none, removes the seed that it left last */
int trocar_client_reset(trocar_client *client);
int trocar_client_leave(trocar_client *client);
int trocar_client_take(trocar_client *client);
int trocar_client_drop_seeds(trocar_client *client, int count, double spacing);
int trocar_client_undo(trocar_client *client);

/* What has become of the last command. */
typedef enum trocar_client_answer {
    TROCAR_CLIENT_NONE,      /* there was no command */
    TROCAR_CLIENT_WAITING,
    TROCAR_CLIENT_DONE,
    TROCAR_CLIENT_REFUSED,   /* nothing was changed */
    TROCAR_CLIENT_UNANSWERED /* for three seconds: there is no server, or the network has lost the command or the reply */
} trocar_client_answer;

/* The answer to the last command. Unless it is DONE, `why`, of `size` bytes, gets the reason (NULL: it is not wanted). RT */
trocar_client_answer trocar_client_reply(trocar_client *client, char *why, size_t size);

#ifdef __cplusplus
}
#endif
#endif
