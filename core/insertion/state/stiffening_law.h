/* Local compliance of tissue that stiffens (Yeoh: stress mu g (1 + 2 S g^2) at the shear g). See docs/mechanics.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_LAW_H
#define TROCAR_STIFFENING_LAW_H

/* Change of the linear displacement under a force by stiffening: `unit` times a function of `scale` times the force. The field around the shaft and the field
   in front of the tip have one function each. */
typedef struct {
    enum { NOT_STIFFENING, STIFFENING_SHAFT, STIFFENING_TIP } field;
    double unit;             /* m */
    double scale;            /* 1/N */
    double most;             /* limit of the tangent, as a multiple of unit * scale */
    double linear;           /* m/N, local compliance of the linear displacement */
} stiffening_law;

/* Value and slope of the law at one force. */
typedef struct {
    double shift;            /* m, added to the linear displacement; its sign is opposite to the force's */
    double slope;            /* m/N, derivative of `shift` by the force; at most 0 */
} stiffening_shift;

/* Law for a line force along a shaft of this radius (m). `stiffness`: length over the linear compliance to a line force per logarithm, N/m. `room`: largest
   decrease of the compliance, m/N; beyond it, the law continues with constant slope. RT */
stiffening_law stiffening_of_shaft(double stiffening, double radius, double stiffness, double room);

/* Law for a disc of this radius (m) and linear compliance `disc` (m/N), in tissue of softness 1 / mu (m^2/N) that fills `angle` steradians around it: 2 pi at
   a surface, 4 pi at depth. RT */
stiffening_law stiffening_of_tip(double stiffening, double radius, double disc, double softness, double angle, double room);

/* RT */
stiffening_shift stiffening_at(const stiffening_law *law, double force);

/* Force at which the total local displacement is `displacement` (m), N; increases with the displacement. RT */
double stiffening_force(const stiffening_law *law, double displacement);

#endif
