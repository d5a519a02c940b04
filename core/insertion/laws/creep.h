/* Creep: tissue that relaxes under a constant strain creeps under a constant force. For each share of the track (the part that one contact represents), the
   tick stores one low-pass filtered force per term of the creep series. Without a relaxation series, these functions have no effect. See docs/mechanics.md,
   "Relaxation". */
#ifndef TROCAR_CREEP_H
#define TROCAR_CREEP_H

#include "insertion/state/tick_data.h"

/* Begins a step: advances the memory's clock and decays the residual loads. RT */
void creep_begin(const tick_input *tick, insertion_state *state, creep_step *creep);

/* Divides the memory among the shares of this step's points; memory beyond the tip becomes residual load. RT */
void creep_divide(const tick_input *tick, insertion_state *state, const contact_points *points, creep_step *creep);

/* Converts all memory to residual loads when the needle no longer touches the tissue. `decay`: decay factors of the step, or NULL between two steps. RT */
void creep_deposit_all(const insertion_model *model, tissue_memory *memory, const double *decay);

/* Adopts changed moduli: the remembered displacements stay the same, so the remembered forces change in proportion to the modulus. RT */
void creep_soften(const insertion_model *model, tissue_memory *memory);

/* Clears all memory, as if the tissue had never been touched. RT */
void creep_forget(tissue_memory *memory);

/* Computes the effects of memory: the displacement of the tissue at each point and the forces that shear the tissue. Multiplies the local compliances
   by the step's yield. To be called after find_tip_rows and find_local_compliance. RT */
void creep_prepare(const tick_input *tick, insertion_state *state, const contact_points *points, tissue_step *tissue, creep_step *creep,
                   const stiffening_step *stiffening);

/* Subtracts the displacement of the sheared tissue from the contact problem's gaps. RT */
void creep_shift_gaps(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                      contact_problem *problem);

/* Displacement (m) of the tissue at the tip, along the track, that results from memory. RT */
double creep_dent(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Adds this step's forces to the memory. RT */
void creep_remember(const tick_input *tick, insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Torque (N m) equivalent to the creep memory of point i in this step; for the tip, the torque on the shaft. Point i must not be a guide's. To be called
   after creep_prepare. RT */
double creep_twist(const tick_input *tick, const creep_step *creep, int i);

/* Load on the tissue (N) that is equivalent to the memory of share i, to be added to the current force. RT */
vec3 creep_load(const insertion_model *model, const tissue_memory *memory, int i);

/* Load (N) that is equivalent to the memory of the tip's share; zero if the tip has no share. RT */
vec3 creep_tip_load(const insertion_model *model, const tissue_memory *memory);

/* Load on the tissue (N) that is equivalent to a residual load. RT */
vec3 creep_residual_load(const insertion_model *model, const residual_load *residual);

/* Traction along the shaft (N/m) that is equivalent to the memory of point i's share. Point i must not be a guide's. To be called after creep_divide. RT */
double creep_traction_of(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep, int i);

/* Sum of all entries of the memory; not finite if any entry is not finite. RT */
double creep_sum(const tissue_memory *memory);

/* Displacement (m) of the node with this handle due to all causes except the needle's current contacts. RT */
vec3 creep_free(const tick_input *tick, const insertion_state *state, const creep_step *creep, int handle);

/* Displacement (m), due to all causes except the needle's current contacts, interpolated at the point with these corners and weights. RT */
vec3 creep_free_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* Mean displacement (m) of the shaft over an interval of depth, or at the beginning of its track, under the loads of other needles and this needle's residual
   loads: only the part that the mesh does not resolve. RT */
vec3 creep_unresolved(const tick_input *tick, const insertion_state *state, const creep_step *creep, double from, double to);
vec3 creep_unresolved_at_entry(const tick_input *tick, const insertion_state *state, const creep_step *creep);

/* True if nothing but the needle's current contacts displaces the tissue: neither other bodies nor this needle's memory. RT */
bool creep_free_is_zero(const tick_input *tick, const insertion_state *state);

/* True if so much residual load has been added that the worker should be informed. RT */
bool creep_has_new_residuals(const tissue_memory *memory);

#endif
