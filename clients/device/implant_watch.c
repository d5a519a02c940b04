#include "device/implant_watch.h"

#include <stdlib.h>

#include "common/message_fit.h"
#include "common/messages.h"
#include "device/playing.h"
#include "lcm_filter.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"

static const double PATIENCE = 0.5; /* s of silence before the watch switches to another server */

static void on_contacts(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    implant_watch *w = context;
    trocar_contacts_t m;
    if (!contacts_fit(received->data, received->data_size) || trocar_contacts_t_decode(received->data, 0, (int)received->data_size, &m) < 0) return;
    bool ours = server_choice_follows(&w->choice, m.server, playing_now()) && m.needle >= 0 && m.needle < TROCAR_MAX_NEEDLES && m.joint_count > 0;
    if (ours) {
        w->bases[m.needle] = library_pose(load_pose(m.centreline[0], m.orientation));
        w->seen[m.needle] = playing_now();
    }
    trocar_contacts_t_decode_cleanup(&m);
}

static void on_deformation(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    implant_watch *w = context;
    trocar_deformation_t m;
    if (!deformation_fits(received->data, received->data_size, w->node_count) || trocar_deformation_t_decode(received->data, 0, (int)received->data_size, &m) < 0) return;
    bool ours = server_choice_follows(&w->choice, m.server, playing_now());
    for (int i = 0; ours && i < w->node_count; i++)
        for (int a = 0; a < 3; a++) w->displacements[3 * i + a] = m.displacement[i][a];
    trocar_deformation_t_decode_cleanup(&m);
}

static void on_seeds(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    implant_watch *w = context;
    trocar_seeds_t m;
    if (!seeds_fit(received->data, received->data_size) || trocar_seeds_t_decode(received->data, 0, (int)received->data_size, &m) < 0) return;
    bool ours = server_choice_follows(&w->choice, m.server, playing_now()) && m.seed_count <= TROCAR_MAX_SEEDS;
    if (ours) w->seed_count = m.seed_count;
    for (int i = 0; ours && i < m.seed_count; i++) {
        w->seed_needles[i] = m.needle[i];
        for (int a = 0; a < 3; a++) w->seeds[i][a] = m.rest_position[i][a];
    }
    trocar_seeds_t_decode_cleanup(&m);
}

trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, trocar_error *why) {
    *w = (implant_watch){.choice.patience = PATIENCE, .node_count = node_count, .displacements = calloc(3 * (size_t)node_count, sizeof(double))};
    if (!w->displacements) return fail(why, TROCAR_NO_MEMORY, "no memory for %d displacements", node_count);
    w->lcm = lcm_create(url);
    if (!w->lcm || !lcm_subscribe(w->lcm, "TROCAR_CONTACTS", on_contacts, w) || !lcm_subscribe(w->lcm, "TROCAR_DEFORMATION", on_deformation, w) ||
        !lcm_subscribe(w->lcm, "TROCAR_SEEDS", on_seeds, w))
        return fail(why, TROCAR_SYSTEM, "LCM cannot receive TROCAR_CONTACTS, TROCAR_DEFORMATION and TROCAR_SEEDS: check the multicast route");
    return TROCAR_OK;
}

void implant_watch_close(implant_watch *w) {
    if (w->lcm) lcm_destroy(w->lcm);
    free(w->displacements);
    *w = (implant_watch){.lcm = NULL};
}

void implant_watch_look(implant_watch *w) {
    while (lcm_handle_timeout(w->lcm, 0) > 0) continue;
}
