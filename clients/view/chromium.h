/* A headless Chromium on one page, in a profile of its own that goes away with it. */
#ifndef TROCAR_CHROMIUM_H
#define TROCAR_CHROMIUM_H

#include <stdbool.h>
#include <sys/types.h>

#include "base/report.h"

typedef struct {
    pid_t process;           /* and its group; 0: none */
    char profile[64];        /* its folder */
} chromium;

/* SYSTEM when it cannot be started; whether it lives is for chromium_ended to say. */
trocar_status chromium_start(chromium *c, const char *url, report *why);
bool chromium_ended(chromium *c);
void chromium_stop(chromium *c);

#endif
