/* The transducer: its pulse and its beam, as Gaussians in depth, across the image and through the image plane. Depths are measured from its face.
   docs/training/ultrasound.md gives the sources of the numbers. */
#ifndef TROCAR_BEAM_H
#define TROCAR_BEAM_H

#define SOUND_SPEED 1540.0   /* m/s, in soft tissue, as scanners assume */

typedef struct {
    double frequency;        /* Hz, centre frequency */
    double bandwidth;        /* -6 dB bandwidth of an echo as a fraction of the centre frequency */
    double f_number;         /* depth divided by the receiving aperture, while that is smaller than `aperture` */
    double aperture;         /* m, the largest receiving aperture; also the transmitting aperture */
    double focus;            /* m, depth of the transmit focus */
    double height;           /* m, elevational aperture (perpendicular to the image plane) */
    double height_focus;     /* m, depth of the lens's elevational focus */
} beam;

extern const beam TRANSRECTAL;

/* Returns the wavelength (m) at the centre frequency. */
double beam_wavelength(const beam *b);

/* Returns the standard deviation in depth (m) of the echo amplitude from a point. */
double beam_pulse_sigma(const beam *b);

/* Return the standard deviations (m) of the echo amplitude from a point, across the image and through the image plane. */
double beam_width_sigma(const beam *b, double depth);
double beam_thickness_sigma(const beam *b, double depth);

#endif
