/* Relaxation of the tissue: the Prony series of the stress under constant strain, and the creep under constant force that follows from it. See
   docs/mechanics.md, "Relaxation". */
#ifndef TROCAR_RELAXATION_H
#define TROCAR_RELAXATION_H

#include "base/error.h"

enum { MAX_RELAXATION = 4 }; /* most terms in a series */

/* One term of the series: the fraction `weight` of the stress under constant strain, which decays as exp(-t / time). */
typedef struct {
    double weight;
    double time;             /* s */
} relaxation_term;

/* Displacement under a constant force, relative to the initial displacement: 1 + sum of compliance (1 - exp(-t / time)). */
typedef struct {
    int count;               /* number of terms; 0 if the tissue is elastic */
    double compliance[MAX_RELAXATION];
    double time[MAX_RELAXATION]; /* s, ascending */
} creep_series;

/* The first fault in a series. */
typedef struct {
    int term;
    const char *key;         /* "weight" or "time"; NULL if the series is valid */
    const char *words;
} relaxation_fault;
relaxation_fault relaxation_check(int count, const relaxation_term *terms);

/* Returns the stress at t (s) after a strain was applied, as a fraction of the initial stress. */
double relaxation_at(int count, const relaxation_term *terms, double t);

/* Computes how tissue with this relaxation creeps. BAD_INPUT if relaxation_check rejects the series. */
trocar_status creep_from_relaxation(int count, const relaxation_term *terms, creep_series *creep, trocar_error *why);

#endif
