#include "intake/other_server.h"

#include <stdio.h>

#include "common/message_fit.h"
#include "printable.h"
#include "trocar_status_t.h"

/* ns without a message after which the other server is presumed stopped; a running one sends ten messages in this time */
static const int64_t ABSENCE = 1000000000;

void other_server_hear(other_server *o, int64_t own, const void *data, size_t size, int64_t now) {
    trocar_status_t m;
    if (!status_fits(data, size) || trocar_status_t_decode(data, 0, (int)size, &m) < 0) return;
    if (m.server != own) {
        o->id = m.server;
        o->heard = now;
        snprintf(o->host, sizeof o->host, "%s", m.host);
        snprintf(o->scene, sizeof o->scene, "%s", m.scene);
        make_printable(o->host);
        make_printable(o->scene);
    }
    trocar_status_t_decode_cleanup(&m);
}

bool other_server_present(const other_server *o, int64_t now) { return o->id != 0 && now - o->heard < ABSENCE; }
