/* A headless Chromium with a temporary profile that shows one page. */
#ifndef TROCAR_CHROMIUM_H
#define TROCAR_CHROMIUM_H

#include <stdbool.h>
#include <sys/types.h>

#include "base/error.h"

typedef struct {
    pid_t process;           /* process and process group; 0 if none is running */
    char profile[512];       /* folder of the profile */
} chromium;

/* Starts the browser. Returns SYSTEM if the process cannot be created. Use chromium_ended to check that it is still running. */
trocar_status chromium_start(chromium *c, const char *url, trocar_error *why);
bool chromium_ended(chromium *c);
void chromium_stop(chromium *c);

#endif
