/* A copy of the needles and seeds in the server's newest messages, for another thread to draw. */
#ifndef TROCAR_BODIES_H
#define TROCAR_BODIES_H

#include "view/stream/subscriber.h"
#include "view/ultrasound/reflectors.h"

enum { BODY_POINTS = TROCAR_MAX_NEEDLES * TROCAR_MAX_JOINTS + 2 * TROCAR_MAX_SEEDS, BODIES = TROCAR_MAX_NEEDLES + TROCAR_MAX_SEEDS };

typedef struct {
    int count, point_count;
    struct {
        int first, count;    /* the body's first point in `points`, and how many points it has */
        double radius;       /* m */
        const acoustics *is;
    } list[BODIES];
    double points[BODY_POINTS][3];
} body_list;

/* Replaces the list with what `feed` contains. `needle_radius` is in m. */
void bodies_take(body_list *b, const subscriber *feed, const trocar_model *model, double needle_radius);

/* Fills `bodies` [BODIES] with the bodies in the list, which point into `b`. Returns how many there are. */
int bodies_of(const body_list *b, echo_body *bodies);

/* Returns the tip of the first needle, or NULL if there is none. */
const double *bodies_tip(const body_list *b);

#endif
