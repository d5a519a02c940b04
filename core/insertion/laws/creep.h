/* Creep: tissue that relaxes under constant strain creeps under constant force. For each share of the track (the length that a contact stands for), the tick
   stores one low-pass filtered force per term of the creep series. If there is no relaxation series, these functions do nothing. See docs/mechanics.md,
   "Relaxation". */
#ifndef TROCAR_CREEP_H
#define TROCAR_CREEP_H

#include "insertion/state/tick_data.h"

/* Begins a step: advances the memory's clock and decays the residual loads. RT */
void creep_begin(const tick_input *tick, insertion_state *state, creep_step *creep);

/* Redistributes the memory over the shares of this step's points. Memory beyond the tip becomes residual load. RT */
void creep_divide(const tick_input *tick, insertion_state *state, const contact_points *points, creep_step *creep);

/* Turns all memory into residual loads once the needle no longer touches the tissue. `decay`: decay factors of the step, or NULL between two steps. RT */
void creep_deposit_all(const insertion_model *model, tissue_memory *memory, const double *decay);

/* Applies a change in moduli: the remembered displacements stay the same, so the remembered forces change in proportion to the modulus. RT */
void creep_soften(const insertion_model *model, tissue_memory *memory);

/* Clears all memory, as if nothing had ever touched the tissue. RT */
void creep_forget(tissue_memory *memory);

/* Computes what memory does in this step: how far it displaces the tissue at each point, and the forces that shear the tissue. Multiplies the local compliances
   by the step's yield. Call this after find_tip_rows and find_local_compliance. RT */
void creep_prepare(const tick_input *tick, insertion_state *state, const contact_points *points, tissue_step *tissue, creep_step *creep,
                   const stiffening_step *stiffening);

/* Subtracts the displacement of the sheared tissue from the contact problem's gaps. RT */
void creep_shift_gaps(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                      contact_problem *problem);

/* Returns the displacement (m) of the tissue at the tip, along the track, due to memory. RT */
double creep_dent(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Adds this step's forces to the memory. RT */
void creep_remember(const tick_input *tick, insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Returns the torque (N m) equivalent to the memory of point i, which must not be at a guide; for the tip, the torque on the shaft. Call this after
   creep_prepare. RT */
double creep_twist(const tick_input *tick, const creep_step *creep, int i);

/* Returns the load on the tissue (N) equivalent to the memory of share i, to be added to the current force. RT */
vec3 creep_load(const insertion_model *model, const tissue_memory *memory, int i);

/* Returns the load (N) equivalent to the memory of the tip's share; zero if the tip has no share. RT */
vec3 creep_tip_load(const insertion_model *model, const tissue_memory *memory);

/* Returns the load on the tissue (N) equivalent to a residual load. RT */
vec3 creep_residual_load(const insertion_model *model, const residual_load *residual);

/* Returns the traction along the shaft (N/m) equivalent to the memory of point i's share. Point i must not be at a guide. Call this after creep_divide. RT */
double creep_traction_of(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep, int i);

/* Returns the sum of all entries of the memory, which is not finite if one of them is not. RT */
double creep_sum(const tissue_memory *memory);

/* Returns the displacement (m) of the node with this handle due to everything but the needle's current contacts. RT */
vec3 creep_free(const tick_input *tick, const insertion_state *state, const creep_step *creep, int handle);

/* Returns the displacement (m) due to everything but the needle's current contacts, interpolated at the point with these corners and weights. RT */
vec3 creep_free_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* Returns the mean displacement (m) of the shaft over an interval of depth, or at the beginning of its track, due to loads of other needles and this needle's
   residual loads. Only the part that the mesh does not resolve. RT */
vec3 creep_unresolved(const tick_input *tick, const insertion_state *state, const creep_step *creep, double from, double to);
vec3 creep_unresolved_at_entry(const tick_input *tick, const insertion_state *state, const creep_step *creep);

/* True if only the needle's current contacts displace the tissue: no other body loads it, and this needle has left no residual loads. RT */
bool creep_free_is_zero(const tick_input *tick, const insertion_state *state);

/* True if enough residual load has been added that the worker should be told. RT */
bool creep_has_new_residuals(const tissue_memory *memory);

#endif
