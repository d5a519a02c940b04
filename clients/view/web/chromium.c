#define _GNU_SOURCE
#include "view/web/chromium.h"

#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/folders.h"

/* Runs the browser with software rendering, so that pictures do not depend on the graphics card. */
static void run_browser(const char *profile, const char *url) {
    char folder[600];
    snprintf(folder, sizeof folder, "--user-data-dir=%s", profile);
    char *sandbox = geteuid() == 0 ? "--no-sandbox" : "--enable-features="; /* the sandbox does not work for root */
    char *arguments[] = {"chromium", "--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
                         "--no-first-run", "--disable-background-networking", "--window-size=1600,1000", sandbox, folder, (char *)url, NULL};
    int nowhere = open("/dev/null", O_RDWR);
    for (int stream = 0; stream < 3; stream++) dup2(nowhere, stream);
    setpgid(0, 0);
    execvp(arguments[0], arguments);
    _exit(127);
}

trocar_status chromium_start(chromium *c, const char *url, trocar_error *why) {
    *c = (chromium){0};
    if (!folders_create_temporary("trocar-view", c->profile, sizeof c->profile)) return fail(why, TROCAR_SYSTEM, "cannot make a temporary folder: %s: set TMPDIR", strerror(errno));
    c->process = fork();
    if (c->process == 0) run_browser(c->profile, url);
    return c->process > 0 ? TROCAR_OK : fail(why, TROCAR_SYSTEM, "cannot start a process: %s", strerror(errno));
}

bool chromium_ended(chromium *c) {
    if (c->process > 0 && waitpid(c->process, NULL, WNOHANG) == c->process) c->process = 0;
    return c->process <= 0;
}

void chromium_stop(chromium *c) {
    if (c->process > 0) {
        kill(-c->process, SIGKILL);
        waitpid(c->process, NULL, 0);
    }
    if (*c->profile) folders_remove(c->profile);
    *c = (chromium){0};
}
