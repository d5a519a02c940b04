/* Finds poses in which the needles wait outside the tissue. */
#ifndef TROCAR_HOMES_H
#define TROCAR_HOMES_H

#include "base/vec.h"
#include "trocar.h"

/* Finds the poses of the bases, homes[count]. The first is the scene's start; or in front of the middle of its template; or along z at the
   middle of the mesh, with the tip 2 mm in front of the surface. The other needles wait beside it. */
void find_homes(const trocar_scene *scene, const trocar_model *model, double needle_length, int count, pose *homes);

/* Returns the pose in front of the template's hole that is closest to a base, or `otherwise` if there is no template. */
pose find_home_of_base(const trocar_model *model, double needle_length, pose base, pose otherwise);

/* Finds the corners of the box around the mesh, m. */
void find_mesh_box(const trocar_model *model, vec3 *low, vec3 *high);

#endif
