/* A file of options: one YAML document, a mapping whose keys are names of long options, with _ or -. Lists are joined by commas. */
#ifndef TROCAR_HAPLY_PROFILE_H
#define TROCAR_HAPLY_PROFILE_H

#include "base/report.h"

/* Passes each option to `set`; `place` is "FILE:LINE". `set` returns BAD_INPUT, and the reason in `why`, for a key that is no option or was given
   before. */
typedef trocar_status (*profile_setter)(void *context, const char *place, const char *key, const char *value, report *why);

trocar_status profile_read(const char *path, profile_setter set, void *context, report *why);

#endif
