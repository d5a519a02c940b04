#include "insertion/laws/creep_kernels.h"

#include "linalg/simd4.h"

void slots_displace(const contact_rows *row, int slot, int end, slot_vectors load, slot_vectors moved, slot_vectors by_beyond) {
    simd4 sum[3] = {simd4_all(0.0), simd4_all(0.0), simd4_all(0.0)};
    for (int j = simd4_below(slot); j < end; j += SIMD4_WIDTH) { /* starts at a multiple of the vector width, so that loads line up with the vectors stored just
                                                                    before */
        simd4 place = simd4_from(j), here[3], there[3], moved_there[3];
        for (int a = 0; a < 3; a++) {
            here[a] = simd4_where(place >= slot, simd4_all(load[a][slot]));
            there[a] = simd4_where(place > slot, simd4_load(&load[a][j]));
            moved_there[a] = simd4_load(&moved[a][j]);
        }
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) {
                simd4 c = simd4_load(&row->at[a][b][j]);
                sum[a] += c * there[b];
                moved_there[b] += c * here[a];
            }
        for (int b = 0; b < 3; b++) simd4_store(&moved[b][j], moved_there[b]);
    }
    for (int a = 0; a < 3; a++) by_beyond[a][slot] = simd4_sum(sum[a]);
}
