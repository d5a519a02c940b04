#include "shared/server_choice.h"

bool server_choice_follows(server_choice *c, int64_t server, double now) {
    bool silent = c->heard == 0 || now - c->heard > c->patience;
    if (server != c->followed && !silent) {
        c->other = server;
        c->other_heard = now;
        return false;
    }
    if (server == c->other) c->other_heard = 0;
    c->followed = server;
    c->heard = now;
    return true;
}

bool server_choice_has_other(const server_choice *c, double now) { return c->other_heard != 0 && now - c->other_heard < 1.0; }
