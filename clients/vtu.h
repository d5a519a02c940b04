/* Export of one state to VTK's XML format for ParaView and for checks of the balance of forces. ASCII with 17 digits:
   what is read back are the bits that were computed. */
#ifndef TROCAR_VTU_H
#define TROCAR_VTU_H

#include "insertion/simulation.h"

/* The tissue as PREFIX-tissue.vtu: the refined mesh (nominal nodes, then active contact nodes)
   at nominal positions. Point data `displacement` m, `applied_force` N on the tissue, `fixed` 0/1; cell data `region`
   (named in a comment), `youngs_modulus` Pa, `poisson_ratio` and, with `volumetric_strain: node`, `volumetric_nodes`: the nominal nodes
   onto which the cell's volumetric strain is averaged. K displacement = applied_force at all nodes not fixed. */
trocar_status vtu_write_tissue(simulation *s, const insertion_state *state, const char *prefix, report *why);

/* The needle as PREFIX-needle.vtu: the deformed centreline through joints and contact points. Point data `force` N on
   the needle, `arc_length` m from the base; field data `base_position` m, `base_force` N and `base_torque` N m, what the
   base exerts on the hand: base_force = sum force, base_torque = sum (point - base_position) x force. */
trocar_status vtu_write_needle(const simulation *s, const insertion_state *state, const insertion_wrench *wrench,
                               const char *prefix, report *why);

#endif
