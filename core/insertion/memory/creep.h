/* Creep: tissue that relaxes under a held strain yields further under a held force. The tick remembers, for each share of the track, a
   low-pass filtered force per term of the creep. Without a series of relaxation, nothing here changes anything. See docs/mechanics.md,
   "Relaxation". */
#ifndef TROCAR_CREEP_H
#define TROCAR_CREEP_H

#include "insertion/state/tick.h"

/* Begins a step: the clock, and the loads that nothing holds. RT */
void creep_begin(const tick_input *tick, insertion_state *state, creep_step *creep);

/* Divides what is remembered among the shares of this step's points; what lies beyond the tip is left in the tissue. RT */
void creep_divide(const tick_input *tick, insertion_state *state, const contact_points *points, creep_step *creep);

/* Nothing touches the tissue: all that is remembered is left in it. `decay`: of the step; NULL: between two steps. RT */
void creep_deposit_all(const insertion_model *model, tissue_memory *memory, const double *decay);

/* The tissue has never been touched. RT */
void creep_forget(tissue_memory *memory);

/* Recalls what this step's displacements start from: displacement of the tissue at each point, and forces that shear it. Local
   compliances are those of a step from here on. After find_tip_rows and find_local_compliance. RT */
void creep_prepare(const tick_input *tick, insertion_state *state, const contact_points *points, tissue_step *tissue, creep_step *creep,
                   const stiffening_step *stiffening);

/* Takes the sheared tissue's displacement off the gaps. RT */
void creep_shift_gaps(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                      contact_problem *problem);

/* Displacement of the tissue at the tip along the track by what is remembered, m. RT */
double creep_dent(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Remembers this step's forces. RT */
void creep_remember(const tick_input *tick, insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep);

/* Torque (N m; after creep_prepare) that what is remembered at point i, no guide's, amounts to in this step; at the tip, on the shaft. RT */
double creep_twist(const tick_input *tick, const creep_step *creep, int i);

/* The load on the tissue, beside the present force, that the memory of share number i amounts to, N. RT */
vec3 creep_load(const insertion_model *model, const tissue_memory *memory, int i);

/* The same of the tip; zero if it has none. RT */
vec3 creep_tip_load(const insertion_model *model, const tissue_memory *memory);

/* The same of a left load. RT */
vec3 creep_residual_load(const insertion_model *model, const left_load *left);

/* Traction along the shaft, N/m, that the memory of the share of point i, no guide's, amounts to; after creep_divide. RT */
double creep_traction_of(const tick_input *tick, const insertion_state *state, const contact_points *points, const creep_step *creep, int i);

/* A number that is finite only if all that is remembered is. RT */
double creep_sum(const tissue_memory *memory);

/* Displacement of a handle that the needle's present contacts do not cause, m. RT */
vec3 creep_free(const tick_input *tick, const insertion_state *state, const creep_step *creep, int handle);

/* The same of the point of these corners and weights. RT */
vec3 creep_free_at(const tick_input *tick, const insertion_state *state, const creep_step *creep, const int handles[4], const double weights[4]);

/* That displacement is zero everywhere: neither others nor what the tissue remembers of this needle displace it. RT */
bool creep_free_is_zero(const tick_input *tick, const insertion_state *state);

/* Is there enough new among the left loads to tell the worker? RT */
bool creep_has_new_residuals(const tissue_memory *memory);

#endif
