/* Local compliance of stiffening tissue (Yeoh material: stress mu g (1 + 2 S g^2) at the shear g). See docs/mechanics.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_LAW_H
#define TROCAR_STIFFENING_LAW_H

/* How stiffening changes the displacement from that of linear tissue: `unit` times a function of (`scale` times the force). The function is one for the field
   around the shaft and another for the field in front of the tip. */
typedef struct {
    enum { NOT_STIFFENING, STIFFENING_SHAFT, STIFFENING_TIP } field;
    double unit;             /* m */
    double scale;            /* 1/N */
    double most;             /* largest magnitude of the slope, in units of unit * scale */
    double linear;           /* m/N, linear local compliance */
} stiffening_law;

/* Value and slope of the law at one force. */
typedef struct {
    double shift;            /* m, added to the linear displacement; its sign is opposite to the force's */
    double slope;            /* m/N, derivative of `shift` with respect to the force; at most 0 */
} stiffening_shift;

/* Returns the law for a line force along a shaft of this radius (m). `stiffness` (N/m): length of the shaft divided by the material factor of its linear local
   compliance (local_line_stiffness). `room` (m/N): largest decrease of the compliance; beyond it, the law continues with constant slope. RT */
stiffening_law stiffening_of_shaft(double stiffening, double radius, double stiffness, double room);

/* Returns the law for a disc of this radius (m) and linear compliance `disc` (m/N), in tissue of softness 1 / mu (m^2/N) that fills `angle` steradians around
   it: 2 pi at a surface, 4 pi deep inside. RT */
stiffening_law stiffening_of_tip(double stiffening, double radius, double disc, double softness, double angle, double room);

/* RT */
stiffening_shift stiffening_at(const stiffening_law *law, double force);

/* Returns the force (N) at which the total local displacement is `displacement` (m). It increases with the displacement. RT */
double stiffening_force(const stiffening_law *law, double displacement);

#endif
