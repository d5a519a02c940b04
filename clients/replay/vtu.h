/* Exports one state in VTK's XML format, for ParaView and for checks of force equilibrium. Numbers are ASCII with 17 digits, so that reading them gives
   exactly the same values. If `patient` is not NULL, positions and displacements are in mm, and all vectors are in the patient's axes. */
#ifndef TROCAR_VTU_H
#define TROCAR_VTU_H

#include <stdbool.h>

#include "base/error.h"
#include "shared/patient.h"
#include "trocar.h"

/* Writes the tissue to PREFIX-tissue.vtu: the refined mesh (nominal nodes, then active contact nodes)
   at nominal positions. Point data `displacement` m, `applied_force` N on the tissue, `fixed` 0/1; cell data `region` (named in a comment),
   `youngs_modulus` Pa, `poisson_ratio`, and the set over which the cell's volumetric strain is averaged: `volumetric_patch`, a patch of cells
   (`volumetric_strain: patch`), or `volumetric_nodes`, nominal nodes (`node`). K displacement = applied_force at all nodes not fixed, where K
   includes the membranes. If the scene has membranes with a stiffness, writes them to PREFIX-membranes.vtu: triangles between nominal nodes, numbered as in
   the tissue's file; point data `displacement` m; cell data `surface`, `stiffness` N/m and `poisson_ratio`. */
trocar_status vtu_write_tissue(const trocar_model *model, trocar_picture *picture, const patient_frame *patient, const char *prefix,
                               trocar_error *why);

/* True if the scene has membranes with a stiffness. */
bool vtu_has_membranes(const trocar_model *model);

/* Writes the needle to PREFIX-needle.vtu: the deformed centreline through joints and contact points. Point data `force` N on the
   needle, `arc_length` m from the base; field data `base_position` m, and `base_force` N and `base_torque` N m exerted by the base on the
   hand: base_force = sum force, base_torque = sum (point - base_position) x force. */
trocar_status vtu_write_needle(const trocar_model *model, const trocar_picture *picture, const trocar_output *output,
                               const patient_frame *patient, const char *prefix, trocar_error *why);

/* Writes the probe to PREFIX-probe.vtu: the surface of the cylinder with its rounded end. Field data `base_position` m, `orientation` w x y z from the
   probe's frame to the mesh's (to the patient's axes with `patient`), `hand_force` N and `hand_torque` N m (about the base) on the hand that holds it,
   `contacts`. A probe that has not been placed has no points. If the scene has no probe, no file is written. */
trocar_status vtu_write_probe(const trocar_model *model, const trocar_picture *picture, const patient_frame *patient, const char *prefix,
                              trocar_error *why);

#endif
