/* How a held needle holds the tissue at its contacts: the message from tick to worker about the needle's side of the contact problem. */
#ifndef TROCAR_NEEDLE_HOLD_H
#define TROCAR_NEEDLE_HOLD_H

#include "snapshot/snapshot.h"

enum { MAX_HOLD_ROWS = 256 };

/* When other loads displace its rows by d, the needle's loads on the tissue change by df, where (C + G) df = -d and C is the tissue's compliance between
   the rows. Rows that slide at constant force are left out. */
typedef struct {
    int count;               /* number of rows; 0 if the needle holds no tissue */
    int unstable;            /* number of negative eigenvalues that C + G has if needle and tissue are stable: the number of buckling modes of the needle without
                                tissue and guides */
    attached_row rows[MAX_HOLD_ROWS];
    double compliance[MAX_HOLD_ROWS * (MAX_HOLD_ROWS + 1) / 2]; /* m/N, G, lower triangle in rows: [i (i + 1) / 2 + j], j <= i: compliance of needle, mount
                                                                   and guides, and of the tissue that the mesh does not resolve */
} needle_hold;

/* Copies only the entries in use, because the arrays are large. RT */
void needle_hold_copy(const needle_hold *from, needle_hold *to);

/* The held needles beside the probe. */
typedef struct {
    int count;
    const needle_hold *of[MAX_NEEDLES];
} needle_holds;

#endif
