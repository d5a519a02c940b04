/* What a model of the needle's elasticity provides; for the models' files and needle.c only. */
#ifndef TROCAR_NEEDLE_KIND_H
#define TROCAR_NEEDLE_KIND_H

#include "needle/needle.h"

struct needle_kind {
    trocar_status (*create)(needle_model *, report *);               /* the parameters are checked, EI and GJ are set */
    void (*rest)(const needle_model *, pose base, needle_state *);
    void (*hold)(const needle_model *, pose base, needle_state *);
    void (*linearise)(const needle_model *, const needle_state *, const vec3 *load, int first, needle_tangent *);
    double (*advance)(const needle_model *, const needle_tangent *, const vec3 *load, needle_state *);
    vec3 (*root_moment)(const needle_model *, const needle_state *);
    double (*energy)(const needle_model *, const needle_state *);
};

extern const needle_kind needle_kind_rod, needle_kind_tetrahedra;

#endif
