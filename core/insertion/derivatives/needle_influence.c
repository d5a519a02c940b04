#include "insertion/derivatives/needle_influence.h"

/* Computes how far a unit force along `axis` moves the joints from `first` on (m/N). The point distributes the force to its joints. */
static void move_joints(const needle_tangent *tangent, int first, int segments, const needle_point *at, vec3 axis, vec3 *moved) {
    for (int joint = first; joint <= segments; joint++) {
        moved[joint] = v3(0, 0, 0);
        for (int k = 0; k < NEEDLE_POINT_JOINTS; k++)
            if (at->weights[k] != 0.0) moved[joint] = v3_add(moved[joint], needle_joint_moved(tangent, joint, at->first + k, v3_scale(at->weights[k], axis)));
    }
}

static vec3 point_moved(const needle_point *p, const vec3 *moved) {
    vec3 sum = v3(0, 0, 0);
    for (int k = 0; k < NEEDLE_POINT_JOINTS; k++) sum = v3_axpy(p->weights[k], moved[p->first + k], sum);
    return sum;
}

/* The tangent of the B-spline at a point is along (1 - f) d0 + f d1, where d0 and d1 are the two segments between the point's joints, and f is the position
   between the segments' midpoints. On the straight half segments at both ends, f is 0 or 1. */
static vec3 tangent_of(const needle_point *p, const vec3 *joints) {
    double f = smaller_of(sqrt(2.0 * p->weights[2]), 1.0);
    vec3 before = v3_sub(joints[p->first + 1], joints[p->first]), after = v3_sub(joints[p->first + 2], joints[p->first + 1]);
    return v3_axpy(f, after, v3_scale(1.0 - f, before));
}

vec3 needle_end_direction(const tick_input *tick, const needle_state *needle) {
    int n = tick->model->needle->given.segments;
    return v3_unit(v3_sub(needle->joints[n], needle->joints[n - 1]));
}

void needle_influence_find(const tick_input *tick, const insertion_workspace *w, needle_influence *influence) {
    const contact_points *points = &w->points;
    int n = tick->model->needle->given.segments, first = n;
    double segment = tick->model->needle->segment_length;
    vec3 moved[NEEDLE_MAX_SEGMENTS + 1];
    for (int i = 0; i < points->count; i++) first = points->list[i].at.first < first ? points->list[i].at.first : first;
    for (int column = 0; column < 3 * points->count; column++) {
        const needle_point *from = &points->list[column / 3].at;
        move_joints(&w->response.tangent, first, n, from, m3_column(&from->frame, column % 3), moved);
        for (int i = 0; i < points->count; i++) {
            const needle_point *p = &points->list[i].at;
            vec3 displaced = point_moved(p, moved), turned = v3_scale(1.0 / segment, tangent_of(p, moved));
            for (int a = 0; a < 3; a++) influence->moved[3 * i + a][column] = v3_dot(m3_column(&p->frame, a), displaced);
            for (int a = 0; a < 2; a++) influence->turned[2 * i + a][column] = v3_dot(m3_column(&p->frame, a), turned);
        }
        influence->end[column] = moved[n];
        influence->end_turned[column] = v3_scale(1.0 / segment, v3_sub(moved[n], moved[n - 1]));
    }
}
