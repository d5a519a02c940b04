/* How a held needle supports the tissue at its contacts: the needle's side of the contact problem, sent by the tick to the worker. */
#ifndef TROCAR_NEEDLE_HOLD_H
#define TROCAR_NEEDLE_HOLD_H

#include "snapshot/snapshot.h"

enum { MAX_HOLD_ROWS = 256 };

/* Each row is a direction at a contact. If other loads displace the tissue by d along the rows, the needle's forces on the tissue change by df = -(C + G)^-1 d,
   where C is the tissue's compliance between the rows. If a contact slides at constant force in some direction, that direction has no row. */
typedef struct {
    int count;               /* number of rows; 0 if the needle gives no support */
    int unstable;            /* how many negative eigenvalues C + G must have for needle and tissue to be stable: as many as the needle would have buckling
                                modes without tissue and guides */
    attached_row rows[MAX_HOLD_ROWS];
    double compliance[MAX_HOLD_ROWS * (MAX_HOLD_ROWS + 1) / 2]; /* m/N, G: compliance of needle, mount and guides, and that of the tissue that the mesh does not
                                                                   resolve. Lower triangle, row by row: [i (i + 1) / 2 + j], j <= i */
} needle_hold;

/* Copies only the entries in use, because the arrays are large. RT */
void needle_hold_copy(const needle_hold *from, needle_hold *to);

/* The held needles that support the tissue against the probe. */
typedef struct {
    int count;
    const needle_hold *of[MAX_NEEDLES];
} needle_holds;

#endif
