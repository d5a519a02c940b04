/* Sends a scripted motion to the server over LCM in real time, and records the answers. */
#ifndef TROCAR_PLAYER_H
#define TROCAR_PLAYER_H

#include "device/hand.h"
#include "device/recording.h"
#include "shared/motion.h"

typedef struct {
    const char *lcm_url;     /* LCM URL; NULL selects $LCM_DEFAULT_URL or, if that is not set, LCM's default */
    const motion *script;
    pose start;
    int needle;              /* index of the needle in the scene */
    double rate;             /* Hz */
    double speed;            /* script seconds per second of real time */
    double duration;         /* s of real time that the motion takes */
    double patience;         /* s to wait for the server's first answer */
    double settle;           /* s to wait before the script starts, while the server ramps the force up */
    bool realtime;           /* request SCHED_FIFO */
    bool closed_loop;        /* a simulated hand, described by `hand`, holds the needle and follows the script */
    hand hand;               /* mass, damping and stiffness of the simulated hand; `play` sets its position and velocity */
} play_settings;

/* Plays the motion until it ends or is interrupted by SIGINT or SIGTERM. Returns SYSTEM if LCM or a timer fails, or if no server answers. */
trocar_status play(const play_settings *settings, recording *r, trocar_error *why);

#endif
