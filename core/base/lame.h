/* Lame parameters (Pa) of an isotropic elastic material. */
#ifndef TROCAR_LAME_H
#define TROCAR_LAME_H

static inline double shear_modulus(double youngs_modulus, double poisson_ratio) { return youngs_modulus / (2.0 * (1.0 + poisson_ratio)); }

static inline double lame_lambda(double youngs_modulus, double poisson_ratio) {
    return youngs_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio));
}

#endif
