/* Pictures: copies of what can be seen of a simulation, for other threads. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_PICTURE_H
#define TROCAR_PUBLIC_PICTURE_H

#include "trocar/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The ticking thread fills a picture after a tick and may hand it to another thread, which looks at it at leisure. */
typedef struct trocar_picture trocar_picture;

/* Creates a picture of straight needles at the origin, up to 150 kB per needle. NO_MEMORY; BAD_INPUT for a model with mesh_only. [any, allocates] */
TROCAR_API trocar_status trocar_picture_create(trocar_model *model, trocar_picture **picture, trocar_error *error);
TROCAR_API void trocar_picture_free(trocar_picture *picture); /* [one] */

/* Copies what has changed, up to 150 kB per needle. Simulation and picture must be of one model. [tick, RT] */
TROCAR_API void trocar_sim_take_picture(const trocar_sim *sim, trocar_picture *picture);
TROCAR_API void trocar_picture_copy(const trocar_picture *from, trocar_picture *to); /* [one, RT] */

/* The view of a picture: its functions may be called by the thread that has the picture. [one, RT] */
TROCAR_API const trocar_view *trocar_picture_view(const trocar_picture *picture);

/* The refined mesh: nodes of the model's mesh, then the contact nodes. Stiffness times displacements = forces at all free nodes. The arrays belong to
   the picture, and are valid until its next call. */
typedef struct trocar_refined_mesh {
    int32_t node_count, tet_count;
    const double *nodes;         /* 3 node_count, m, at rest */
    const int32_t *tets;         /* 4 tet_count */
    const int32_t *parents;      /* tet_count: the tetrahedron of the model's mesh that contains it */
    const double *displacements; /* 3 node_count, m */
    const double *forces;        /* 3 node_count, N, on the tissue */
    double damping[3];           /* N, part of `forces` that the needle does not feel: it slows tissue that springs back at the tip */
} trocar_refined_mesh;

/* Costs one call of trocar_view_displacements. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_picture_refined_mesh(trocar_picture *picture, trocar_refined_mesh *mesh, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
