/* How volumes and bodies scatter, reflect and absorb ultrasound. docs/training/ultrasound.md gives the sources. */
#ifndef TROCAR_ACOUSTICS_H
#define TROCAR_ACOUSTICS_H

#include "trocar.h"

typedef struct {
    double backscatter;      /* dB, speckle brightness relative to the prostate */
    double attenuation;      /* dB/(cm MHz), one way */
    double impedance;        /* MRayl */
} acoustics;

extern const acoustics BONE, STEEL, TITANIUM;

/* Finds the properties of a volume of the model by its name. A volume that cannot be cut counts as bone, and a name that is not in the table as connective
   tissue. */
acoustics acoustics_of(const trocar_model *model, int region);

/* Returns the fraction of the pressure that is reflected at normal incidence. */
double reflection(double impedance, double other);

#endif
