/* Stiffening tissue in the contact problem: what its local compliances lack of linear ones. Nothing changes where no tissue stiffens. See
   README.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_H
#define TROCAR_STIFFENING_H

#include "insertion/tick.h"

/* Keeps the shear of the tissue along each share as the share comes to lie in other regions: what keep_shear, which comes after it,
   leaves to the stiffening. RT */
void stiffening_keep_shear(const tick_context *tick);

/* The laws of this step's points. After find_local_compliance, before creep_recall. RT */
void stiffening_prepare(const tick_context *tick);

/* Compliance along the shaft at point i under this force, on top of the linear one, m/N; at most 0. RT */
double stiffening_slope(const tick_context *tick, int i, double force);

/* Linearises about the present forces. RT */
void stiffening_linearise(const tick_context *tick);

/* Adds what was linearised to the contact problem: to its compliance, and to its gaps. RT */
void stiffening_add_compliance(const tick_context *tick);
void stiffening_shift_gaps(const tick_context *tick);

/* Is the displacement with the new forces the one that was linearised? RT */
bool stiffening_agrees(const tick_context *tick);

#endif
