/* Computes a scene's condensed inverse and stores it for later starts of the server, possibly on another machine. Needs neither a network nor real-time
   operation. */
#ifndef TROCAR_CONDENSE_H
#define TROCAR_CONDENSE_H

#include <stdio.h>

#include "base/error.h"

/* Computes the condensed inverse and prints where it is stored. BAD_INPUT for a bad scene, for a scene whose inverse is not condensed, and for a
   mesh that needs more memory than the machine has; NO_MEMORY if too little memory is free before the elimination begins; SYSTEM if the file cannot
   be written, which is checked before the computation. */
trocar_status condense_scene(const char *scene_path, FILE *out, trocar_error *why);

#endif
