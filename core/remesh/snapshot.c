#include "remesh/snapshot.h"

static int handle_of(const compliance_snapshot *snapshot, int node) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (snapshot->window[k] == node) return MAX_CONTACTS + k;
    return -1;
}

bool snapshot_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]) {
    if (snapshot->serial == 0) return false;
    for (int c = 0; c < 4; c++) {
        handles[c] = handle_of(snapshot, nodes[c]);
        if (handles[c] < 0) return false;
    }
    return true;
}

mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other) {
    mat3 block = {{{0}}};
    m3_add_block(&block, 1.0, &snapshot->compliance[3 * handle * SNAPSHOT_LD + 3 * other], SNAPSHOT_LD);
    return block;
}

mat3 compliance_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other) {
    mat3 sum = {{{0}}};
    for (int c = 0; c < 4; c++) m3_add_block(&sum, weights[c], &snapshot->compliance[3 * handles[c] * SNAPSHOT_LD + 3 * other], SNAPSHOT_LD);
    return sum;
}

int snapshot_known_contacts(const compliance_snapshot *snapshot, const refinement *refined) {
    if (snapshot->serial == 0) return 0;
    int known = 0;
    while (known < refined->count && refined->nodes[refined->order[known]].id == snapshot->ids[refined->order[known]]) known++;
    return known;
}
