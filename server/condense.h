/* Computes a scene's condensed inverse and saves it, so that servers started later, perhaps on another machine, need not compute it. Works without a network
   and without real-time scheduling. */
#ifndef TROCAR_CONDENSE_H
#define TROCAR_CONDENSE_H

#include <stdio.h>

#include "base/error.h"

/* Computes the condensed inverse and prints where it is saved. BAD_INPUT if the scene is invalid or its inverse is not condensed, or if the mesh needs more
   memory than the machine has. NO_MEMORY if too little memory is free when the elimination is about to begin. SYSTEM if the file cannot be written, which is
   checked before computing. */
trocar_status condense_scene(const char *scene_path, FILE *out, trocar_error *why);

#endif
