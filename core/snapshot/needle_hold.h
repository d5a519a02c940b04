/* How a held needle supports the tissue at its contacts: a message from tick to worker with the needle's side of the contact problem. */
#ifndef TROCAR_NEEDLE_HOLD_H
#define TROCAR_NEEDLE_HOLD_H

#include "snapshot/snapshot.h"

enum { MAX_HOLD_ROWS = 256 };

/* Each row is a direction at a contact. If other loads displace the tissue by d along the rows, the needle's loads on the tissue change by df = -(C + G)^-1 d,
   where C is the tissue's compliance between the rows. Directions in which a contact slides at constant force have no row. */
typedef struct {
    int count;               /* number of rows; 0 if the needle does not support the tissue */
    int unstable;            /* number of negative eigenvalues of C + G if needle and tissue are stable: the number of buckling modes that the needle would have
                                without tissue or guides */
    attached_row rows[MAX_HOLD_ROWS];
    double compliance[MAX_HOLD_ROWS * (MAX_HOLD_ROWS + 1) / 2]; /* m/N, G: compliance of needle, mount and guides, and the part of the tissue's compliance that
                                                                   the mesh does not resolve. Lower triangle, row by row: [i (i + 1) / 2 + j], j <= i */
} needle_hold;

/* Copies only the entries in use, because the arrays are large. RT */
void needle_hold_copy(const needle_hold *from, needle_hold *to);

/* The held needles that support the tissue against the probe. */
typedef struct {
    int count;
    const needle_hold *of[MAX_NEEDLES];
} needle_holds;

#endif
