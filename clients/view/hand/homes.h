/* Poses in which the needles wait outside the tissue. */
#ifndef TROCAR_HOMES_H
#define TROCAR_HOMES_H

#include "base/vec.h"
#include "trocar.h"

/* Poses of the bases, homes[count]: the scene's start; or in front of the middle of its template; or along z with the tip 2 mm in front of the
   surface, at the middle of the mesh. Needles after the first wait beside it. */
void find_homes(const trocar_scene *scene, const trocar_model *model, double needle_length, int count, pose *homes);

/* The pose in front of the template's hole closest to a base; `otherwise` if there is no template. */
pose find_home_of_base(const trocar_model *model, double needle_length, pose base, pose otherwise);

/* Corners of the box around the mesh, m. */
void find_mesh_box(const trocar_model *model, vec3 *low, vec3 *high);

#endif
