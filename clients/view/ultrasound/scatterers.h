/* Scatterers: points at random positions in each tetrahedron, which move with the tissue. Nothing is stored per scatterer. All take their barycentric
   coordinates from one table, which each tetrahedron, or each part of a large one, reads from its own offset. */
#ifndef TROCAR_SCATTERERS_H
#define TROCAR_SCATTERERS_H

#include "view/ultrasound/grid.h"

typedef struct {
    int tet_count;
    const int32_t *tets;
    float *expected;         /* [tet_count], mean number of scatterers */
    float *amplitudes;       /* [tet_count], amplitude of each scatterer */
    float *table;            /* positions and phases: see fill_table in scatterers.c */
} scatterers;

/* `density`: scatterers per m^3 of undeformed tissue. `amplitudes`: [regions]. Returns NO_MEMORY if out of memory. */
trocar_status scatterers_create(scatterers *s, const trocar_model *model, double density, const float *amplitudes, trocar_error *why);
void scatterers_free(scatterers *s);

/* Adds the echoes of all scatterers in the beam. `nodes` are the mesh's nodes. */
void scatterers_add(const scatterers *s, const image_point *nodes, echo_grid *g);

#endif
