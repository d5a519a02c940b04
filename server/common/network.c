#include "common/network.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "lcm_filter.h"

static const char *given(const char *url) {
    if (url == NULL || *url == '\0') url = getenv("LCM_DEFAULT_URL");
    return url != NULL && *url != '\0' ? url : "udpm://239.255.76.67:7667?ttl=0";
}

static bool has_provider(const char *url) {
    static const char *const providers[] = {"udpm://", "memq://", "file://", "tcpq://"};
    for (size_t i = 0; i < sizeof providers / sizeof *providers; i++)
        if (strncmp(url, providers[i], strlen(providers[i])) == 0) return true;
    return false;
}

trocar_status network_open(const char *url, lcm_t **opened, trocar_error *why) {
    url = given(url);
    if (!has_provider(url))
        return fail(why, TROCAR_BAD_INPUT, "LCM cannot use \"%s\": give --lcm-url or LCM_DEFAULT_URL as udpm://GROUP:PORT?ttl=N", url);
    *opened = lcm_filter_create(url);
    if (*opened != NULL) return TROCAR_OK;
    const char *group = strstr(url, "://") + 3;
    return fail(why, TROCAR_SYSTEM, "LCM cannot connect to \"%s\": check the address and the multicast route. On a single machine without a "
                "network, as root: ip link set lo multicast on && ip route add %.*s/32 dev lo", url, (int)strcspn(group, ":?"), group);
}
