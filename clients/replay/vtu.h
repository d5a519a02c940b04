/* Exports one state in VTK's XML format, for ParaView and for checking the equilibrium of forces. Numbers are ASCII with 17 digits, so they can be read back
   exactly. If `patient` is not NULL, positions and displacements are in mm, and all vectors are in the patient's axes. */
#ifndef TROCAR_VTU_H
#define TROCAR_VTU_H

#include <stdbool.h>

#include "base/error.h"
#include "shared/patient.h"
#include "trocar.h"

/* Writes the tissue to PREFIX-tissue.vtu: the refined mesh (nominal nodes, then active contact nodes) in its undeformed state.
   Point data: `displacement` m, `applied_force` N on the tissue, `fixed` 0/1. At all nodes that are not fixed, K displacement = applied_force, where K
   includes the membranes.
   Cell data: `region` (a comment gives the names), `youngs_modulus` Pa, `poisson_ratio`, and what the cell's volumetric strain is averaged over: a patch
   of cells, `volumetric_patch` (if `volumetric_strain` is `patch`), or nominal nodes, `volumetric_nodes` (if it is `node`).

   If the scene has stiff membranes, also writes them to PREFIX-membranes.vtu: triangles between nominal nodes, numbered as in the tissue's file. Point data:
   `displacement` m. Cell data: `surface`, `stiffness` N/m, `poisson_ratio`. */
trocar_status vtu_write_tissue(const trocar_model *model, trocar_picture *picture, const patient_frame *patient, const char *prefix,
                               trocar_error *why);

/* True if the scene has membranes with a stiffness. */
bool vtu_has_membranes(const trocar_model *model);

/* Writes the needle to PREFIX-needle.vtu: the deformed centreline through joints and contact points.
   Point data: `force` N on the needle, `arc_length` m from the base.
   Field data: `base_position` m, and `base_force` N and `base_torque` N m exerted on the hand by the base. They satisfy base_force = sum force and
   base_torque = sum (point - base_position) x force. */
trocar_status vtu_write_needle(const trocar_model *model, const trocar_picture *picture, const trocar_output *output,
                               const patient_frame *patient, const char *prefix, trocar_error *why);

/* Writes the probe to PREFIX-probe.vtu: the surface of the cylinder and its rounded end. If the probe has not been placed, the file has no points; if the
   scene has no probe, no file is written.
   Field data: `base_position` m, `orientation` (w x y z, from the probe's frame to the mesh's or, with `patient`, to the patient's axes), `hand_force` N and
   `hand_torque` N m (about the base) on the hand that holds the probe, `contacts`. */
trocar_status vtu_write_probe(const trocar_model *model, const trocar_picture *picture, const patient_frame *patient, const char *prefix,
                              trocar_error *why);

#endif
