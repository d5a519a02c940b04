#include "condensed/inverse_choice.h"

#include <math.h>

#include "condensed/condensation.h"
#include "linalg/symmetric_blocks.h"

static const char *const names[INVERSE_CHOICES] = {"auto", "dense", "sparse", "condensed"};

const char *inverse_choice_name(inverse_choice choice) { return names[choice]; }

static const char *const precisions[PRECISIONS] = {"auto", "double", "single"};

const char *inverse_precision_name(inverse_precision precision) { return precisions[precision]; }

bool inverse_is_single(inverse_precision given, int nodes) {
    static const double MUCH = 0.5e9; /* bytes; if double precision would take more, `auto` selects single precision */
    return given == PRECISION_SINGLE || (given == PRECISION_AUTO && (double)symmetric_blocks_bytes(nodes, false) > MUCH);
}

__attribute__((format(printf, 3, 4)))
static inverse_choice choose(trocar_error *about, inverse_choice choice, const char *format, ...) {
    va_list arguments;
    char reason[256];
    va_start(arguments, format);
    decimal_vprint(reason, sizeof reason, format, arguments);
    va_end(arguments);
    snprintf(about->text, sizeof about->text, "%s (%s)", names[choice], reason);
    return choice;
}

inverse_choice inverse_choose(const inverse_facts *facts, trocar_error *about) {
    static const double LITTLE = 1.0;      /* GB, largest dense inverse */
    static const double MUCH = 4.0;        /* GB, largest condensed inverse */
    static const double SHARE = 0.25;      /* fraction of the machine's memory that the inverse may take */
    static const double BRIEF_SHARE = 0.5; /* fraction of the machine's memory that computing a condensed inverse may take */
    int nodes = facts->node_count, roi = facts->roi_count;
    double dense = 8e-9 * facts->dof_count * facts->dof_count, share = SHARE * 1e-9 * facts->memory;
    double condensed = 1e-9 * (double)symmetric_blocks_bytes(roi, inverse_is_single(facts->precision, roi));
    if (facts->given != INVERSE_AUTO) return choose(about, facts->given, "set in the scene");
    if (dense <= fmin(LITTLE, share)) return choose(about, INVERSE_DENSE, "%d nodes: %.3g GB", nodes, dense);
    if (!facts->roi_given)
        return choose(about, INVERSE_SPARSE, "%d nodes: dense would take %.3g GB, and there is no region_of_interest", nodes, dense);
    double making = 1e-9 * condensation_bytes(roi), half = BRIEF_SHARE * 1e-9 * facts->memory;
    if (condensed <= fmin(MUCH, share) && making > half)
        return choose(about, INVERSE_SPARSE, "region of %d nodes: condensed would take %.3g GB while it is made, more than %.3g GB; dense %.3g GB", roi,
                      making, half, dense);
    if (condensed <= fmin(MUCH, share))
        return choose(about, INVERSE_CONDENSED, "region of %d nodes: %.3g GB; dense would take %.3g GB", roi, condensed, dense);
    return choose(about, INVERSE_SPARSE, "region of %d nodes: condensed would take %.3g GB, more than %.3g GB; dense %.3g GB", roi,
                  condensed, fmin(MUCH, share), dense);
}
