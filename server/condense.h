/* Makes a scene's condensed inverse for later starts, possibly on another machine, without network and real time. */
#ifndef TROCAR_CONDENSE_H
#define TROCAR_CONDENSE_H

#include <stdio.h>

#include "base/report.h"

/* Prints where the inverse is stored. BAD_INPUT for a bad scene, or one whose inverse is not condensed; NO_MEMORY, before the elimination begins
   (BAD_INPUT if the machine can never have as much); SYSTEM, before it is computed, if the file cannot be written. */
trocar_status condense_scene(const char *scene_path, FILE *out, report *why);

#endif
