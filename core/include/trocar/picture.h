/* Pictures: snapshots of a simulation's visible state, for other threads. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_PICTURE_H
#define TROCAR_PUBLIC_PICTURE_H

#include "trocar/view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The ticking thread fills a picture after a tick and can then hand it to another thread, which processes it at its own pace. */
typedef struct trocar_picture trocar_picture;

/* Creates a picture that shows straight needles at the origin. Takes up to 150 kB per needle. NO_MEMORY; BAD_INPUT for a model with mesh_only.
   [any, allocates] */
TROCAR_API trocar_status trocar_picture_create(trocar_model *model, trocar_picture **picture, trocar_error *error);
TROCAR_API void trocar_picture_free(trocar_picture *picture); /* [one] */

/* Copies to the picture what has changed since the last call, up to 150 kB per needle. Both must belong to the same model. [tick, RT] */
TROCAR_API void trocar_sim_take_picture(const trocar_sim *sim, trocar_picture *picture);
TROCAR_API void trocar_picture_copy(const trocar_picture *from, trocar_picture *to); /* [one, RT] */

/* Returns the picture's view. Only the thread that currently has the picture may pass it to the functions in trocar/view.h. [one, RT] */
TROCAR_API const trocar_view *trocar_picture_view(const trocar_picture *picture);

/* The refined mesh. Its nodes are those of the model's mesh, followed by the contact nodes. At free nodes, stiffness times displacements equals `forces`. The
   arrays belong to the picture, and are valid until trocar_picture_refined_mesh is next called for it. */
typedef struct trocar_refined_mesh {
    int32_t node_count, tet_count;
    const double *nodes;         /* [node_count][3], m, positions at rest */
    const int32_t *tets;         /* [tet_count][4], node indices */
    const int32_t *parents;      /* [tet_count]: tetrahedron of the model's mesh that contains each tetrahedron */
    const double *displacements; /* [node_count][3], m */
    const double *forces;        /* [node_count][3], N, forces on the tissue */
    double damping[3];           /* N, the part of `forces` that damps the rebound of tissue at the tip; the needle does not feel it */
} trocar_refined_mesh;

/* Computes the refined mesh. Takes as long as one call to trocar_view_displacements. NO_MEMORY. [one, allocates] */
TROCAR_API trocar_status trocar_picture_refined_mesh(trocar_picture *picture, trocar_refined_mesh *mesh, trocar_error *error);

#ifdef __cplusplus
}
#endif
#endif
