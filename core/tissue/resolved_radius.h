/* Measures how close to a needle the mesh still resolves the needle's displacement field. Infinite and finite line forces and a point force act on a small
   patch of elements whose boundary moves as in the exact solution; the mesh's displacement is compared with that solution. No constant is fitted. See
   docs/mechanics.md, "Local compliance". */
#ifndef TROCAR_RESOLVED_RADIUS_H
#define TROCAR_RESOLVED_RADIUS_H

#include "tissue/tissue.h"

static const double EMBEDDING_DEPTH = 4.0; /* radii: a disc or shaft at least this far below the surface counts as embedded in an infinite body. Fitted to
                                              resolved finite elements with a disc, within 2 % */

/* Correction for a line force that ends near the needle's tip, where the mesh's lateral compliance differs from that of a cylinder with the resolved radius.
   `more` is added to the logarithm of the radius. It is averaged over the directions across the line; along the line, the effect is too small to measure on a
   patch. */
enum { LINE_ENDS = 4 };
typedef struct {
    double reach;            /* m, how far the body extends ahead of the point; a line at least this long is treated as infinite */
    double more[LINE_ENDS];  /* correction for a line that ends (k / LINE_ENDS)^2 of the reach ahead of the point */
} line_end;

/* Interpolates `more` for a line that ends this far ahead (m). RT */
double line_end_at(const line_end *end, double ahead);

/* Computes to += scale * from for all members. RT */
void line_end_add_scaled(line_end *to, double scale, const line_end *from);

/* Returns the sum of all members, which is finite only if all of them are. RT */
double line_end_total(const line_end *end);

/* The measurement at one point on the line. The material is taken to be uniform, as in the point's element, and without membranes, so that only the mesh
   matters. */
typedef struct {
    double lateral, axial;   /* m, radius of the rigid cylinder that yields to a line force as much as the mesh does. `lateral`: geometric mean over the
                                directions across the line */
    mat3 uneven;             /* symmetric: a force along the unit vector e across the line adds e.uneven e to the logarithm of the radius */
    line_end end;            /* correction for a line that ends ahead of the point, in the line's direction */
    double point;            /* 1/m, displacement of the mesh along the line due to a unit force at the point, times the shear modulus */
} resolved_field;

/* A line through an element, for a piece of the needle's path. */
typedef struct {
    int tet;
    vec3 point, direction;   /* point, m: a point on the line; direction: a unit vector */
} line_in_tet;

static inline bool line_same(const line_in_tet *a, const line_in_tet *b) { return a->tet == b->tet && v3_same(a->point, b->point) && v3_same(a->direction, b->direction); }

/* Displacement of the mesh around an infinite line due to a unit force per unit length, for a shear modulus of 1. Kelvin's solution minus this
   displacement is the part of the interaction between this needle and nearby ones that the mesh does not resolve. */
enum { FIELD_NODES = 256 };
typedef struct {
    line_in_tet line;
    mat3 frame;              /* columns: the axes of the line's frame */
    double poisson_ratio, softness; /* Poisson's ratio and 1 / mu (m^2/N) of the element that contains the line */
    int count, nodes[FIELD_NODES]; /* nodes of the mesh */
    vec3 moved[FIELD_NODES][3]; /* displacement in the line's frame due to a force along each of its axes. Dimensionless, as in exact_fields.h */
} line_field;

typedef struct resolver resolver;

/* Creates a resolver; `t` must outlive it. NO_MEMORY. */
trocar_status resolver_create(const tissue *t, resolver **created, trocar_error *why);
void resolver_free(resolver *r);

enum { MAX_RESOLVED = 3 };

/* Measures at `count` points of element `tet`, all on one line along the unit vector `direction`. Takes about a millisecond; does not allocate memory. Measures
   `end` only at the first and the last point. NUMERIC if the patch has no stiffness. */
trocar_status resolver_measure(resolver *r, int tet, vec3 direction, int count, const vec3 *x, resolved_field *resolved, trocar_error *why);

/* Computes the field of one line. NUMERIC if the patch has no stiffness. */
trocar_status resolver_spread(resolver *r, const line_in_tet *line, line_field *field, trocar_error *why);

/* Returns 1 / mu (m^2/N) of an element. Multiply the fields of lines through it by this. */
double resolver_softness(const resolver *r, int tet);

/* Returns the part of the displacement at x (with these weights in element `tet`) that the mesh does not resolve, divided by the force per unit length on the
   line (m^2/N, world frame). If x is closer to the line than `radius` (m), that distance is used. Zero outside the patch, where the mesh is fine enough for the
   field. */
mat3 line_field_lacks(const line_field *field, const mesh *m, int tet, const double weights[4], vec3 x, double radius);

#endif
