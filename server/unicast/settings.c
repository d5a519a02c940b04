#define _GNU_SOURCE
#include "unicast/settings.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/host_port.h"

enum { LEAST = 32, MOST = 1024 }; /* bytes of a secret */
static const char MAKE_ONE[] = "make one with: (umask 077; head -c 32 /dev/urandom | base64 >FILE)";

trocar_status settings_address(const char *text, struct sockaddr_in *address, trocar_error *why) {
    char full[300], host[256], port[6];
    snprintf(full, sizeof full, "%s%s", *text == ':' ? "0.0.0.0" : "", text);
    if (!split_host_port(full, NULL, host, port))
        return fail(why, TROCAR_BAD_INPUT, "--listen %s: give HOST:PORT, such as 0.0.0.0:7668 for all IPv4 addresses of this machine", text);
    const struct addrinfo wanted = {.ai_family = AF_INET, .ai_socktype = SOCK_DGRAM, .ai_flags = AI_PASSIVE};
    struct addrinfo *found = NULL;
    int error = getaddrinfo(host, port, &wanted, &found);
    if (error != 0) return fail(why, TROCAR_BAD_INPUT, "--listen %s: %s", text, gai_strerror(error));
    memcpy(address, found->ai_addr, sizeof *address);
    freeaddrinfo(found);
    return TROCAR_OK;
}

static trocar_status read_secret(int descriptor, const char *file, wire_key *key, trocar_error *why) {
    struct stat s;
    char secret[MOST + 3];
    if (fstat(descriptor, &s) != 0 || !S_ISREG(s.st_mode)) return fail(why, TROCAR_BAD_INPUT, "secret file %s: not a regular file", file);
    mode_t allowed = s.st_uid == 0 && s.st_gid == 0 ? S_IRGRP : 0; /* a systemd credential belongs to root; an access control list lets the service read it,
                                                                      which shows up as group access */
    if ((s.st_mode & 077 & ~allowed) != 0)
        return fail(why, TROCAR_BAD_INPUT, "secret file %s: other users have access (mode %03o); run chmod 600 on it", file, (unsigned)s.st_mode & 0777);
    ssize_t size = read(descriptor, secret, sizeof secret);
    if (size < 0) return fail(why, TROCAR_BAD_INPUT, "secret file %s: %s", file, strerror(errno));
    while (size > 0 && (secret[size - 1] == '\n' || secret[size - 1] == '\r')) size--;
    if (size < LEAST || size > MOST)
        return fail(why, TROCAR_BAD_INPUT, "secret file %s: a secret has %d to %d bytes; %s", file, LEAST, MOST, MAKE_ONE);
    *key = wire_secret_key(secret, (size_t)size);
    explicit_bzero(secret, sizeof secret);
    return TROCAR_OK;
}

trocar_status settings_secret(const char *file, const struct sockaddr_in *address, wire_key *key, trocar_error *why) {
    bool local = ntohl(address->sin_addr.s_addr) >> 24 == IN_LOOPBACKNET;
    if (file == NULL && !local)
        return fail(why, TROCAR_BAD_INPUT, "--listen on an address that other machines can reach needs --secret-file FILE; %s", MAKE_ONE);
    if (file == NULL) return *key = wire_secret_key("", 0), TROCAR_OK;
    int descriptor = open(file, O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK);
    if (descriptor < 0) return fail(why, TROCAR_BAD_INPUT, "secret file %s: %s; %s", file, strerror(errno), MAKE_ONE);
    trocar_status status = read_secret(descriptor, file, key, why);
    close(descriptor);
    return status;
}
