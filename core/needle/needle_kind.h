/* Interface of an elastic model of the needle; included by the models' files and needle.c only. */
#ifndef TROCAR_NEEDLE_KIND_H
#define TROCAR_NEEDLE_KIND_H

#include "needle/needle_model.h"

struct needle_kind {
    trocar_status (*create)(needle_model *, report *);               /* called with checked parameters and with EI and GJ set */
    void (*rest)(const needle_model *, pose base, needle_state *);
    void (*hold)(const needle_model *, pose base, needle_state *);
    void (*linearise)(const needle_model *, const needle_state *, const vec3 *load, int first, needle_tangent *);
    void (*motion)(const needle_model *, const needle_state *before, const needle_state *after, needle_motion *);
    void (*go_on)(const needle_model *, const needle_motion *, double fraction, needle_state *);
    double (*advance)(const needle_model *, const needle_tangent *, const vec3 *load, needle_state *);
    vec3 (*root_moment)(const needle_model *, const needle_state *);
    double (*energy)(const needle_model *, const needle_state *);
};

extern const needle_kind needle_kind_rod, needle_kind_tetrahedra;

#endif
