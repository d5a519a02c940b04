/* Plays a scripted motion to the server over LCM in real time and records the answers. */
#ifndef TROCAR_PLAYER_H
#define TROCAR_PLAYER_H

#include "device/hand.h"
#include "device/recording.h"
#include "shared/motion.h"

typedef struct {
    const char *lcm_url;     /* NULL: $LCM_DEFAULT_URL or LCM's default */
    const motion *script;
    pose start;
    int needle;              /* index in the scene */
    double rate;             /* Hz */
    double speed;            /* script seconds per second */
    double duration;         /* s, real time */
    double patience;         /* s to wait for the server's first answer */
    double settle;           /* s at rest before the script starts, while the server ramps the force up */
    bool realtime;           /* ask for SCHED_FIFO */
    bool closed_loop;        /* `hand` holds the needle and follows the script */
    hand hand;               /* mass, damping, stiffness; position and velocity are set here */
} play_settings;

/* Plays until the end or an interrupt (SIGINT, SIGTERM). SYSTEM if LCM or a timer fails or no server answers. */
trocar_status play(const play_settings *settings, recording *r, report *why);

#endif
