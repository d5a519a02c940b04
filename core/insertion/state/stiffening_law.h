/* Local compliance of a tissue that stiffens (Yeoh: stress mu g (1 + 2 S g^2) at the shear g). See docs/mechanics.md, "Stiffening". */
#ifndef TROCAR_STIFFENING_LAW_H
#define TROCAR_STIFFENING_LAW_H

/* What stiffening adds to the linear displacement under a force: `unit` times a function of `scale` times the force. There is one function
   for the field around the shaft and one for the field in front of the tip. */
typedef struct {
    enum { NOT_STIFFENING, STIFFENING_SHAFT, STIFFENING_TIP } field;
    double unit;             /* m */
    double scale;            /* 1/N */
    double most;             /* limit of the tangent, as a multiple of unit * scale */
    double linear;           /* m/N, local compliance that it is added to */
} stiffening_law;

/* At one force. */
typedef struct {
    double shift;            /* m, added to the linear displacement; its sign is opposite to the force's */
    double slope;            /* m/N, derivative of `shift` by the force; at most 0 */
} stiffening_shift;

/* A line force over a shaft of this radius, m. `stiffness`: length over the linear compliance of a line force per logarithm, N/m.
   `room`: m/N, by which the compliance may fall; beyond, the law goes on with constant slope. RT */
stiffening_law stiffening_of_shaft(double stiffening, double radius, double stiffness, double room);

/* A disc of this radius, m, of linear compliance `disc`, m/N, in tissue of compliance `softness` = 1 / mu, m^2/N, that fills
   `angle` steradians around it: 2 pi at a surface, 4 pi in the depth. RT */
stiffening_law stiffening_of_tip(double stiffening, double radius, double disc, double softness, double angle, double room);

/* RT */
stiffening_shift stiffening_at(const stiffening_law *law, double force);

/* The force under which the local displacement, linear and added, is this (m), N. It increases with the displacement. RT */
double stiffening_force(const stiffening_law *law, double displacement);

#endif
