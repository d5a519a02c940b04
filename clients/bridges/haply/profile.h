/* Reads a profile, which is a file of options: one YAML document whose keys are long option names, with _ or -. List items are joined with commas. */
#ifndef TROCAR_HAPLY_PROFILE_H
#define TROCAR_HAPLY_PROFILE_H

#include "base/error.h"

/* Called for each option in the profile; `place` is "FILE:LINE". Returns BAD_INPUT, with the reason in `why`, if the key is not an option or was already
   given. */
typedef trocar_status (*profile_setter)(void *context, const char *place, const char *key, const char *value, trocar_error *why);

trocar_status profile_read(const char *path, profile_setter set, void *context, trocar_error *why);

#endif
