/* How volumes and bodies scatter, reflect and absorb ultrasound; sources in docs/training/ultrasound.md. */
#ifndef TROCAR_ACOUSTICS_H
#define TROCAR_ACOUSTICS_H

#include "trocar.h"

typedef struct {
    double backscatter;      /* dB, brightness of the speckle relative to the prostate's */
    double attenuation;      /* dB/(cm MHz), one way */
    double impedance;        /* MRayl */
} acoustics;

extern const acoustics BONE, STEEL, TITANIUM;

/* Finds the properties of a volume of the model by its name; a volume that cannot be cut has those of bone. Names that are not in the table count as
   connective tissue. */
acoustics acoustics_of(const trocar_model *model, int region);

/* Returns the fraction of the pressure that is reflected at normal incidence. */
double reflection(double impedance, double other);

#endif
