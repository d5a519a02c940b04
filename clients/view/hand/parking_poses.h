/* Finds the poses in which the needles wait outside the tissue. */
#ifndef TROCAR_PARKING_POSES_H
#define TROCAR_PARKING_POSES_H

#include "base/vec.h"
#include "trocar.h"

/* Finds the waiting poses of the needles' bases, parking_poses[count]. The first is the scene's start pose. If there is none, it is in front of the centre of
   the template; without a template, the needle lies along z at the middle of the mesh, its tip 2 mm in front of the surface. The other needles wait next to the
   first. */
void find_parking_poses(const trocar_scene *scene, const trocar_model *model, double needle_length, int count, pose *parking_poses);

/* Returns the waiting pose in front of the template's hole nearest to a base, or `otherwise` if there is no template. */
pose find_home_of_base(const trocar_model *model, double needle_length, pose base, pose otherwise);

/* Finds the corners of the mesh's bounding box (m). */
void find_mesh_box(const trocar_model *model, vec3 *low, vec3 *high);

#endif
