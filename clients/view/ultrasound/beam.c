#include "view/ultrasound/beam.h"

#include <math.h>

/* The frequency and bandwidth are those of an array for transrectal imaging, 62 % at 5.66 MHz (Chen, Nguyen, Yen 2012). The f-number reproduces the -6 dB beam
   width of 0.92 mm that the same authors computed for their transverse images. The apertures and focal depths are assumptions. */
const beam TRANSRECTAL = {.frequency = 5.66e6, .bandwidth = 0.62, .f_number = 3.8, .aperture = 8e-3, .focus = 0.03, .height = 4e-3, .height_focus = 0.03};

static const double HALF_WIDTH = 2.354820045; /* full width at half maximum of a Gaussian, in standard deviations: sqrt(8 ln 2) */
static const double SINC_HALF = 1.206709;     /* full width at half maximum of sin(pi x) / (pi x) */
static const double SINC_SQUARED_HALF = 0.885893; /* full width at half maximum of the square of sin(pi x) / (pi x) */

double beam_wavelength(const beam *b) { return SOUND_SPEED / b->frequency; }

/* A Gaussian spectrum of standard deviation s belongs to a pulse of standard deviation 1/(2 pi s) in time. Depth is half of the path. */
double beam_pulse_sigma(const beam *b) {
    double spectrum = b->bandwidth * b->frequency / HALF_WIDTH;
    return 0.5 * SOUND_SPEED / (2 * M_PI * spectrum);
}

/* Returns the one-way width of a beam from an aperture with a fixed focus. Two effects add up: diffraction, which is proportional to depth, and the
   convergence of the aperture towards the focus. */
static double fixed_focus(double diffraction, double aperture, double focus, double depth) {
    return hypot(diffraction * depth / focus, aperture / sqrt(12.0) * (1 - depth / focus));
}

/* The beam is the product of the transmitted beam and the receiving beam, whose focus follows the echo. At the transmit focus, if both apertures are equal, it
   is as wide as a squared sinc. */
double beam_width_sigma(const beam *b, double depth) {
    double per_f_number = sqrt(2.0) * SINC_SQUARED_HALF * beam_wavelength(b) / HALF_WIDTH;
    double sent = fixed_focus(per_f_number * b->focus / b->aperture, b->aperture, b->focus, depth);
    double received = per_f_number * fmax(b->f_number, depth / b->aperture);
    return 1 / hypot(1 / sent, 1 / received);
}

/* The same lens focuses the transmitted and the received sound. */
double beam_thickness_sigma(const beam *b, double depth) {
    double diffraction = SINC_HALF * beam_wavelength(b) * b->height_focus / (b->height * HALF_WIDTH);
    return fixed_focus(diffraction, b->height, b->height_focus, depth) / sqrt(2.0);
}
