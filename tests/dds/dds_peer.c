/* Plays the part of a ROS node: publishes poses, and prints the serialised samples of all three topics in hexadecimal, so that the test decodes them itself.
   usage: dds_peer DOMAIN NAMESPACE best-effort|reliable
   Each line of standard input is a pose, as in ROS: x y z, then the quaternion x y z w, and the frame_id ("-": empty). Standard output has the lines
   "pose HEX", "wrench HEX", "joint_states HEX", and for each endpoint that is discovered "endpoint TOPIC TYPE RELIABILITY". Exits at the end of its input. */
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>

#include "ros.h"

enum { POSE, WRENCH, JOINTS, TOPICS, MOST = 64 };

static const char *const names[TOPICS] = {"pose", "wrench", "joint_states"};
static dds_entity_t participant, readers[TOPICS], writer, endpoints[2];

static dds_entity_t check(dds_entity_t entity, const char *what) {
    if (entity >= 0) return entity;
    fprintf(stderr, "dds_peer: %s: %s\n", what, dds_strretcode(entity));
    exit(1);
}

static void create_entities(int domain, const char *name_space, bool reliable) {
    static const dds_topic_descriptor_t *const types[TOPICS] = {&geometry_msgs_msg_dds__PoseStamped__desc, &geometry_msgs_msg_dds__WrenchStamped__desc,
                                                                &sensor_msgs_msg_dds__JointState__desc};
    participant = check(dds_create_participant((dds_domainid_t)domain, NULL, NULL), "participant");
    dds_qos_t *qos = dds_create_qos();
    dds_qset_reliability(qos, reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, DDS_SECS(1));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, MOST);
    for (int i = 0; i < TOPICS; i++) {
        char full[256];
        snprintf(full, sizeof full, "rt/%s/%s", name_space, names[i]);
        dds_entity_t topic = check(dds_create_topic(participant, types[i], full, NULL, NULL), full);
        readers[i] = check(dds_create_reader(participant, topic, qos, NULL), full);
        if (i == POSE) writer = check(dds_create_writer(participant, topic, qos, NULL), full);
    }
    dds_delete_qos(qos);
    endpoints[0] = check(dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, NULL, NULL), "publications");
    endpoints[1] = check(dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION, NULL, NULL), "subscriptions");
}

static void print_samples(int topic) {
    struct ddsi_serdata *samples[MOST] = {NULL};
    dds_sample_info_t about[MOST];
    int count = dds_takecdr(readers[topic], samples, MOST, about, DDS_ANY_STATE);
    for (int i = 0; i < count; i++) {
        unsigned char bytes[4096];
        uint32_t size = ddsi_serdata_size(samples[i]);
        if (about[i].valid_data && size <= sizeof bytes) {
            ddsi_serdata_to_ser(samples[i], 0, size, bytes);
            printf("%s ", names[topic]);
            for (uint32_t k = 0; k < size; k++) printf("%02x", bytes[k]);
            printf("\n");
        }
        ddsi_serdata_unref(samples[i]);
    }
}

static void print_endpoints(dds_entity_t reader) {
    void *samples[MOST] = {NULL};
    dds_sample_info_t about[MOST];
    int count = dds_take(reader, samples, about, MOST, MOST);
    for (int i = 0; i < count; i++) {
        const dds_builtintopic_endpoint_t *e = samples[i];
        dds_reliability_kind_t kind = DDS_RELIABILITY_RELIABLE;
        dds_duration_t most;
        if (!about[i].valid_data) continue;
        dds_qget_reliability(e->qos, &kind, &most);
        dds_guid_t own;
        dds_get_guid(participant, &own);
        if (memcmp(&own, &e->participant_key, sizeof own) == 0) continue;
        printf("endpoint %s %s %s\n", e->topic_name, e->type_name, kind == DDS_RELIABILITY_RELIABLE ? "reliable" : "best-effort");
    }
    if (count > 0) dds_return_loan(reader, samples, count);
}

static bool publish_line(const char *line) {
    char frame[100];
    geometry_msgs_msg_dds__PoseStamped_ m = {.header.frame_id = frame};
    geometry_msgs_msg_dds__Point_ *x = &m.pose.position;
    geometry_msgs_msg_dds__Quaternion_ *q = &m.pose.orientation;
    if (sscanf(line, "%lf %lf %lf %lf %lf %lf %lf %99s", &x->x, &x->y, &x->z, &q->x, &q->y, &q->z, &q->w, frame) != 8) return false;
    if (strcmp(frame, "-") == 0) frame[0] = '\0';
    return dds_write(writer, &m) == 0;
}

int main(int count, char **arguments) {
    if (count != 4) return 2;
    create_entities(atoi(arguments[1]), arguments[2], strcmp(arguments[3], "reliable") == 0);
    setvbuf(stdout, NULL, _IOLBF, 0);
    struct pollfd in = {.fd = STDIN_FILENO, .events = POLLIN};
    static char text[1 << 16];
    size_t length = 0;
    for (;;) {
        if (poll(&in, 1, 1) > 0) {
            ssize_t got = read(STDIN_FILENO, text + length, sizeof text - 1 - length);
            if (got <= 0) break;
            length += (size_t)got;
            text[length] = '\0';
            char *line = text, *end;
            for (; (end = strchr(line, '\n')); line = end + 1) {
                *end = '\0';
                if (!publish_line(line)) return 1;
            }
            length = strlen(line);
            memmove(text, line, length + 1);
        }
        for (int i = 0; i < TOPICS; i++) print_samples(i);
        for (int i = 0; i < 2; i++) print_endpoints(endpoints[i]);
    }
    return dds_delete(participant) == 0 ? 0 : 1;
}
