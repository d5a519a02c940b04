/* A checksum of everything on which results depend: two models with the same checksum continue a saved state in the same way. */
#ifndef TROCAR_MODEL_CHECKSUM_H
#define TROCAR_MODEL_CHECKSUM_H

#include "model/model_parts.h"
#include "scene/scene_struct.h"

/* Returns a checksum of the mesh and its fixed nodes, which is the same for derived models. */
uint64_t mesh_checksum(const model_parts *parts);

/* Returns a checksum of the mesh, the kind of inverse, and all keys of the scene that describe the simulation. It does not include paths, the rate of the
   haptic loop, the device and the needle's start. `mesh`: mesh_checksum of the model. */
uint64_t model_checksum(uint64_t mesh, const scene *s, const model_parts *parts);

#endif
