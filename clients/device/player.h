/* Plays a scripted motion to the server over LCM in real time, and records the server's answers. */
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
    double speed;            /* script speed, in script seconds per second of real time */
    double duration;         /* s of real time, duration of the motion */
    double patience;         /* s to wait for the server's first answer */
    double settle;           /* s, pause before the script starts, while the server ramps the force up */
    bool realtime;           /* request SCHED_FIFO */
    bool closed_loop;        /* true: a simulated hand, described by `hand`, holds the needle and follows the script */
    hand hand;               /* mass, damping and stiffness of that hand; `play` sets position and velocity */
} play_settings;

/* Plays the motion until its end or an interrupt (SIGINT, SIGTERM). SYSTEM if LCM or a timer fails, or if no server answers. */
trocar_status play(const play_settings *settings, recording *r, trocar_error *why);

#endif
