/* The transducer: its pulse and its beam, as Gaussians in depth, across the image and through the image plane. Depths are measured from its face. The sources of
   the numbers are in docs/training/ultrasound.md. */
#ifndef TROCAR_BEAM_H
#define TROCAR_BEAM_H

#define SOUND_SPEED 1540.0   /* m/s, in soft tissue: the value that scanners assume */

typedef struct {
    double frequency;        /* Hz, centre frequency */
    double bandwidth;        /* width of the spectrum of an echo at -6 dB, divided by the frequency */
    double f_number;         /* depth divided by the receiving aperture, while that is smaller than `aperture` */
    double aperture;         /* m, largest receiving aperture, and the transmitting aperture */
    double focus;            /* m, depth to which the transmitted beam is focused */
    double height;           /* m, elevational aperture (perpendicular to the image plane) */
    double height_focus;     /* m, depth of the lens's elevational focus */
} beam;

extern const beam TRANSRECTAL;

/* Returns the wavelength at the centre frequency, m. */
double beam_wavelength(const beam *b);

/* Returns the standard deviation of a point's echo amplitude in depth, m. */
double beam_pulse_sigma(const beam *b);

/* These functions return the standard deviations of a point's echo amplitude across the image, and through the image plane, m. */
double beam_width_sigma(const beam *b, double depth);
double beam_thickness_sigma(const beam *b, double depth);

#endif
