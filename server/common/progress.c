#include "common/progress.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "trocar.h"

void progress_show(const char *what, double fraction, void *context) {
    (void)context;
    enum { WIDTH = 40 };
    static char task[64];
    static int shown = -1;
    bool terminal = isatty(STDERR_FILENO);
    int percent = (int)(100.0 * fraction + 1e-9), step = terminal ? 1 : 10;
    if (strncmp(task, what, sizeof task - 1) != 0 || percent < shown) shown = -1;
    if (percent / step == shown / step && shown >= 0) return;
    snprintf(task, sizeof task, "%s", what);
    shown = percent;
    int filled = WIDTH * percent / 100;
    if (terminal)
        fprintf(stderr, "\r%s [%.*s%*s] %3d %%%s", what, filled, "########################################", WIDTH - filled, "", percent,
                percent == 100 ? "\n" : "");
    else
        fprintf(stderr, "%s: %d %%\n", what, percent / step * step);
}

void progress_log(int32_t level, const char *message, void *context) {
    if (level >= TROCAR_LOG_WARNING) fprintf(stderr, "%s: warning: %s\n", (const char *)context, message);
    else fprintf(stderr, "%s\n", message);
}

void progress_warn(int32_t level, const char *message, void *context) {
    if (level >= TROCAR_LOG_WARNING) progress_log(level, message, context);
}
