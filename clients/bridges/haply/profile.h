/* An options file: one YAML document whose keys are the names of long options, written with _ or -. The items of a list are joined by commas. */
#ifndef TROCAR_HAPLY_PROFILE_H
#define TROCAR_HAPLY_PROFILE_H

#include "base/error.h"

/* Receives each option of the profile; `place` is "FILE:LINE". Returns BAD_INPUT, with the reason in `why`, for a key that is not an option or has
   been given before. */
typedef trocar_status (*profile_setter)(void *context, const char *place, const char *key, const char *value, trocar_error *why);

trocar_status profile_read(const char *path, profile_setter set, void *context, trocar_error *why);

#endif
