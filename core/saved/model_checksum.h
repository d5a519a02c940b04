/* A checksum of everything that results depend on. If two models have the same checksum, a saved state continues in the same way in both. */
#ifndef TROCAR_MODEL_CHECKSUM_H
#define TROCAR_MODEL_CHECKSUM_H

#include "model/model_parts.h"
#include "scene/scene_struct.h"

/* Returns a checksum of the mesh and its fixed nodes. Derived models have the same one. */
uint64_t mesh_checksum(const model_parts *parts);

/* Returns a checksum of the mesh, the kind of inverse, and all scene keys that describe the simulation. Leaves out paths, the rate of the haptic loop, the
   device and the needle's start. `mesh`: the model's mesh_checksum. */
uint64_t model_checksum(uint64_t mesh, const scene *s, const model_parts *parts);

#endif
