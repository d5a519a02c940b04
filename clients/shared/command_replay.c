#include "shared/command_replay.h"

#include "common/handover.h"

static bool is_undo(const logged_command *logged) { return logged->command.command == TROCAR_COMMAND_T_UNDO && logged->answer == ANSWER_DONE; }

trocar_status replay_seed_command(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *logged, trocar_error *why) {
    if (logged->answer == ANSWER_REFUSED) return TROCAR_OK;
    if (w->drop && is_undo(logged)) { /* the server executed the drop and then cancelled it */
        w->drop = NULL;
        return TROCAR_OK;
    }
    trocar_status status = handle_seeds(sim, needle, &logged->command, why);
    bool refused = status == TROCAR_BAD_INPUT || status == TROCAR_NUMERIC;
    bool drop = logged->command.command == TROCAR_COMMAND_T_DROP_SEED && logged->answer == ANSWER_DONE;
    if (!refused || !drop || trocar_view_pending_seeds(trocar_sim_view(sim), needle) == 0) return status;
    w->drop = &logged->command;
    w->reason = *why;
    return TROCAR_OK;
}

bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle) {
    if (!w->drop || trocar_view_pending_seeds(trocar_sim_view(sim), needle) > 0) return true;
    bool done = handle_seeds(sim, needle, w->drop, &w->reason) == TROCAR_OK;
    w->drop = NULL;
    return done;
}

bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next) {
    bool goes_on = next && (next->answer == ANSWER_REFUSED || is_undo(next)); /* see replay_seed_command */
    if (!w->drop || goes_on) return true;
    bool done = try_waiting_drop(w, sim, needle) && !w->drop;
    w->drop = NULL;
    return done;
}

bool end_waiting_change(waiting_change *w) {
    bool none = !w->change;
    trocar_change_free(w->change);
    w->change = NULL;
    return none;
}

trocar_status try_waiting_change(waiting_change *w, trocar_sim *sim, trocar_error *why) {
    if (!w->change || !trocar_sim_accepts(sim, w->change)) return TROCAR_OK;
    trocar_status status = trocar_sim_change(sim, w->change, w->time, why);
    end_waiting_change(w);
    return status;
}

trocar_status replay_change(waiting_change *w, trocar_sim *sim, const logged_command *logged, trocar_error *why) {
    if (logged->answer == ANSWER_REFUSED) return TROCAR_OK;
    if (w->change) return fail(why, TROCAR_BAD_INPUT, "a change comes before an earlier one could begin");
    trocar_status status = trocar_change_create(sim, &w->change, why);
    if (status != TROCAR_OK) return status;
    w->time = logged->change_time == 0.0 ? TROCAR_CHANGE_TIME : logged->change_time;
    status = trocar_change_set(w->change, logged->change, why);
    if (status == TROCAR_OK) status = trocar_change_prepare(w->change, NULL, why);
    if (status == TROCAR_OK) return try_waiting_change(w, sim, why);
    end_waiting_change(w);
    return status;
}
