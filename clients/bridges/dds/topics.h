/* ROS 2 topics for a needle, over CycloneDDS: poses come in, wrenches and joint states go out. The topics follow ROS conventions for names, types and quality
   of service (the sensor data profile: best effort, volatile, last five samples), so ROS nodes can use them, but ROS need not be installed. */
#ifndef TROCAR_DDS_TOPICS_H
#define TROCAR_DDS_TOPICS_H

#include <stdbool.h>
#include <stdint.h>

#include "base/error.h"
#include "base/vec.h"

enum { DOMAIN_MAX = 232 };                     /* highest domain that has UDP ports in DDS */

typedef struct {
    int domain;                                /* DDS domain, as in ROS_DOMAIN_ID */
    const char *name_space;                    /* namespace of the topics, without the leading slash: "trocar" for /trocar/pose, ... */
    const char *frame;                         /* frame_id of all messages */
} topic_settings;

typedef struct topics topics;

/* Joins the domain and creates the topics. BAD_INPUT if CycloneDDS finds no network or cannot use its configuration. */
trocar_status topics_open(const topic_settings *settings, topics **opened, trocar_error *why);
void topics_close(topics *t);

/* Gets the newest pose (m) received since the last call; false if there is none. Poses are rejected if they are in another frame, contain a number that is not
   finite or an orientation that is not a unit quaternion, or come from a second publisher while the first one is still sending. The reason is printed on
   stderr, but not again for every pose. */
bool topics_take_pose(topics *t, pose *newest);

/* The published state of a needle. */
typedef struct {
    pose base;                                 /* m */
    vec3 force, torque;                        /* N and N m, world frame: exerted by the needle's base on the hand, torque about the base */
    double depth;                              /* m, length of the needle's track in the tissue */
} needle_state;

/* Publishes the wrench and the state of two joints: "insertion", with the depth and the axial force, and "roll", with the base's rotation about the needle
   axis (rad, the twist of its orientation, from -pi to pi) and the axial torque. */
void topics_publish(topics *t, const needle_state *state);

#endif
