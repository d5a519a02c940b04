#include "topics.h"

#include <stdlib.h>
#include <string.h>

#include <dds/dds.h>

#include "device/playing.h"
#include "ros.h"
#include "shared/server_choice.h"

enum { DEPTH = 5 }; /* history depth, as in ROS's sensor data profile */
static const double SILENCE = 1;               /* s, a new publisher is accepted once the current one has been silent for this long */
static const double UNIT_TOLERANCE = 1e-3;     /* allowed deviation of a quaternion's length from 1, as in the server */

struct topics {
    dds_entity_t participant, poses, wrenches, joints;
    char *frame;
    server_choice publisher;
    char said[256];                            /* the last reason printed, and when (s, monotonic) */
    double said_at;
};

/* ---- set-up ---- */

static dds_entity_t find_topic(const topics *t, const topic_settings *s, const char *name, const dds_topic_descriptor_t *type) {
    char full[256];
    snprintf(full, sizeof full, "rt/%s/%s", s->name_space, name); /* ROS adds the prefix rt/ to topic names */
    return dds_create_topic(t->participant, type, full, NULL, NULL);
}

static dds_entity_t create_entities(topics *t, const topic_settings *s) {
    t->participant = dds_create_participant((dds_domainid_t)s->domain, NULL, NULL);
    if (t->participant < 0) return t->participant;
    dds_qos_t *sensor_data = dds_create_qos();
    dds_qset_reliability(sensor_data, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_durability(sensor_data, DDS_DURABILITY_VOLATILE);
    dds_qset_history(sensor_data, DDS_HISTORY_KEEP_LAST, DEPTH);
    t->poses = dds_create_reader(t->participant, find_topic(t, s, "pose", &geometry_msgs_msg_dds__PoseStamped__desc), sensor_data, NULL);
    t->wrenches = dds_create_writer(t->participant, find_topic(t, s, "wrench", &geometry_msgs_msg_dds__WrenchStamped__desc), sensor_data, NULL);
    t->joints = dds_create_writer(t->participant, find_topic(t, s, "joint_states", &sensor_msgs_msg_dds__JointState__desc), sensor_data, NULL);
    dds_delete_qos(sensor_data);
    return t->poses < 0 ? t->poses : t->wrenches < 0 ? t->wrenches : t->joints;
}

trocar_status topics_open(const topic_settings *settings, topics **opened, trocar_error *why) {
    topics *t = calloc(1, sizeof *t);
    if (!t || !(t->frame = strdup(settings->frame))) {
        free(t);
        return fail(why, TROCAR_NO_MEMORY, "no memory for the topics");
    }
    t->publisher.patience = SILENCE;
    dds_entity_t status = create_entities(t, settings);
    if (status >= 0) {
        *opened = t;
        return TROCAR_OK;
    }
    topics_close(t);
    return fail(why, TROCAR_BAD_INPUT, "CycloneDDS cannot join domain %d (%s): is a network interface up, and is $CYCLONEDDS_URI valid?", settings->domain,
                dds_strretcode(status));
}

void topics_close(topics *t) {
    if (!t) return;
    if (t->participant > 0) dds_delete(t->participant);
    free(t->frame);
    free(t);
}

/* ---- poses ---- */

/* Converts a message to a pose. Sets `why` to the reason if the pose must be rejected, otherwise to "". */
static void examine(const topics *t, const geometry_msgs_msg_dds__PoseStamped_ *m, pose *p, char why[256]) {
    const geometry_msgs_msg_dds__Point_ *x = &m->pose.position;
    const geometry_msgs_msg_dds__Quaternion_ *q = &m->pose.orientation;
    *p = (pose){{x->x, x->y, x->z}, {q->w, q->x, q->y, q->z}};
    double norm = sqrt(q->w * q->w + q->x * q->x + q->y * q->y + q->z * q->z);
    why[0] = '\0';
    if (m->header.frame_id && *m->header.frame_id && strcmp(m->header.frame_id, t->frame) != 0)
        snprintf(why, 256, "its frame_id is \"%.80s\" and not \"%.80s\": transform it, or set --frame", m->header.frame_id, t->frame);
    else if (!isfinite(v3_norm(p->position)) || !isfinite(norm)) snprintf(why, 256, "a number is not finite");
    else if (fabs(norm - 1) > UNIT_TOLERANCE) snprintf(why, 256, "its orientation (x, y, z, w) has the norm %g and not 1", norm);
    else p->orientation = q_unit(p->orientation);
}

/* Prints a reason unless it is the one last printed. Prints at most one line per second, because with two faulty publishers the reasons may keep
   alternating. */
static void say(topics *t, const char *why, double now) {
    if (strcmp(why, t->said) == 0 || (*t->said && now - t->said_at < 1)) return;
    fprintf(stderr, "trocar-dds: a pose is refused: %s\n", why);
    snprintf(t->said, sizeof t->said, "%s", why);
    t->said_at = now;
}

bool topics_take_pose(topics *t, pose *newest) {
    void *samples[DEPTH] = {NULL};
    dds_sample_info_t about[DEPTH];
    bool found = false;
    double now = playing_now();
    int count = dds_take(t->poses, samples, about, DEPTH, DEPTH);
    for (int i = 0; i < count; i++) {
        pose p;
        char why[256];
        if (!about[i].valid_data) continue;
        examine(t, samples[i], &p, why);
        if (!*why && !server_choice_follows(&t->publisher, (int64_t)about[i].publication_handle, now))
            snprintf(why, sizeof why, "another node publishes poses already");
        if (*why) {
            say(t, why, now);
            continue;
        }
        *newest = p;
        found = true;
    }
    if (count > 0) dds_return_loan(t->poses, samples, count);
    return found;
}

/* ---- state ---- */

static std_msgs_msg_dds__Header_ make_header(const topics *t) {
    dds_time_t now = dds_time(); /* since the epoch, like ROS time */
    return (std_msgs_msg_dds__Header_){.stamp = {(int32_t)(now / DDS_NSECS_IN_SEC), (uint32_t)(now % DDS_NSECS_IN_SEC)}, .frame_id = t->frame};
}

void topics_publish(topics *t, const needle_state *s) {
    geometry_msgs_msg_dds__WrenchStamped_ wrench = {.header = make_header(t), .wrench = {.force = {s->force.x, s->force.y, s->force.z},
                                                                                          .torque = {s->torque.x, s->torque.y, s->torque.z}}};
    vec3 axis = q_axis(s->base.orientation);
    char *names[] = {"insertion", "roll"};
    double positions[] = {s->depth, 2 * atan2(s->base.orientation.z, s->base.orientation.w)};
    if (fabs(positions[1]) > M_PI) positions[1] -= copysign(2 * M_PI, positions[1]);
    double efforts[] = {v3_dot(s->force, axis), v3_dot(s->torque, axis)};
    sensor_msgs_msg_dds__JointState_ joints = {.header = wrench.header, .name = {2, 2, names, false}, .position = {2, 2, positions, false},
                                               .effort = {2, 2, efforts, false}};
    dds_write(t->wrenches, &wrench);
    dds_write(t->joints, &joints);
}
