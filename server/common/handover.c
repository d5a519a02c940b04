#include "common/handover.h"

#include "common/messages.h"

hand_clutch clutch_engage(pose hand, const trocar_pose *base) {
    return (hand_clutch){.engaged = true, .from = hand, .to = load_pose(base->position, base->orientation)};
}

pose clutch_follow(const hand_clutch *clutch, pose hand) {
    if (!clutch->engaged) return hand;
    quat turn = q_multiply(clutch->to.orientation, q_conjugate(clutch->from.orientation));
    return (pose){v3_add(clutch->to.position, v3_sub(hand.position, clutch->from.position)), q_unit(q_multiply(turn, hand.orientation))};
}

trocar_status handle_seeds(trocar_sim *sim, int needle, const trocar_command_t *m, trocar_error *why) {
    if (m->command == TROCAR_COMMAND_T_UNDO) return trocar_sim_undo_seed(sim, needle, why);
    if (m->command == TROCAR_COMMAND_T_CLEAR) return trocar_sim_clear_seeds(sim, needle, why);
    return trocar_sim_drop_seeds(sim, needle, m->seeds, m->spacing, why);
}

trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why) {
    static const double AWAY = 10.0; /* m, how far a removed needle is moved back along its axis */
    trocar_pose base = trocar_view_base(trocar_sim_view(sim), needle);
    pose at = load_pose(base.position, base.orientation);
    store_vec3(v3_axpy(-AWAY, q_axis(at.orientation), at.position), base.position);
    return trocar_sim_reset(sim, needle, &base, why);
}
