#include "view/ultrasound/bodies.h"

static void begin(body_list *b, double radius, const acoustics *is) {
    b->list[b->count].first = b->point_count;
    b->list[b->count].count = 0;
    b->list[b->count].radius = radius;
    b->list[b->count++].is = is;
}

static void add(body_list *b, double x, double y, double z) {
    double *point = b->points[b->point_count++];
    point[0] = x, point[1] = y, point[2] = z;
    b->list[b->count - 1].count++;
}

static void add_seed(body_list *b, const trocar_seeds_t *seeds, int i, trocar_seed_size size) {
    const float *x = seeds->position[i], *d = seeds->direction[i];
    begin(b, 0.5 * size.diameter, &TITANIUM);
    for (int end = -1; end <= 1; end += 2) {
        double half = 0.5 * end * size.length;
        add(b, (double)x[0] + half * (double)d[0], (double)x[1] + half * (double)d[1], (double)x[2] + half * (double)d[2]);
    }
}

void bodies_take(body_list *b, const subscriber *feed, const trocar_model *model, double needle_radius) {
    b->count = b->point_count = 0;
    for (int i = 0; i < feed->needle_count; i++) {
        const trocar_contacts_t *c = feed->needles[i].contacts;
        if (!c || c->joint_count < 2 || c->joint_count > TROCAR_MAX_JOINTS) continue;
        begin(b, needle_radius, &STEEL);
        for (int j = 0; j < c->joint_count; j++) add(b, c->centreline[j][0], c->centreline[j][1], c->centreline[j][2]);
    }
    for (int i = 0; feed->seeds && i < feed->seeds->seed_count && i < TROCAR_MAX_SEEDS; i++) add_seed(b, feed->seeds, i, trocar_model_seed_size(model));
}

int bodies_of(const body_list *b, echo_body *bodies) {
    for (int i = 0; i < b->count; i++)
        bodies[i] = (echo_body){b->points[b->list[i].first], b->list[i].count, b->list[i].radius, b->list[i].is};
    return b->count;
}

const double *bodies_tip(const body_list *b) {
    return b->count > 0 && b->list[0].is == &STEEL ? b->points[b->list[0].first + b->list[0].count - 1] : NULL;
}
