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
    double height;           /* m, aperture across the image plane */
    double height_focus;     /* m, depth to which the lens focuses across the image plane */
} beam;

extern const beam TRANSRECTAL;

/* m, wavelength at the centre frequency. */
double beam_wavelength(const beam *b);

/* m, standard deviation in depth of the amplitude of a point's echo. */
double beam_pulse_sigma(const beam *b);

/* m, standard deviation across the image, and through the image plane, of the amplitude of a point's echo. */
double beam_width_sigma(const beam *b, double depth);
double beam_thickness_sigma(const beam *b, double depth);

#endif
