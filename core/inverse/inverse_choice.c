#include "inverse/inverse_choice.h"

#include <math.h>

static const char *const names[INVERSE_CHOICES] = {"auto", "dense", "sparse", "condensed"};

const char *inverse_choice_name(inverse_choice choice) { return names[choice]; }

__attribute__((format(printf, 3, 4)))
static inverse_choice choose(report *about, inverse_choice choice, const char *format, ...) {
    va_list arguments;
    char reason[256];
    va_start(arguments, format);
    vsnprintf(reason, sizeof reason, format, arguments);
    va_end(arguments);
    snprintf(about->text, sizeof about->text, "%s (%s)", names[choice], reason);
    return choice;
}

inverse_choice inverse_choose(const inverse_facts *facts, report *about) {
    static const double LITTLE = 1.0, MUCH = 4.0, SHARE = 0.25; /* GB; of the machine's memory */
    int nodes = facts->node_count, roi = facts->roi_count;
    double dense = 8e-9 * facts->dof_count * facts->dof_count, condensed = 72e-9 * roi * roi, share = SHARE * 1e-9 * facts->memory;
    if (facts->given != INVERSE_AUTO) return choose(about, facts->given, "as the scene asks");
    if (remesh_needs_dense(facts->remeshing))
        return choose(about, INVERSE_DENSE, "remeshing by %s works on all of it: %.3g GB", remesh_name(facts->remeshing), dense);
    if (dense <= fmin(LITTLE, share)) return choose(about, INVERSE_DENSE, "%d nodes: %.3g GB", nodes, dense);
    if (!facts->roi_given)
        return choose(about, INVERSE_SPARSE, "%d nodes: dense would take %.3g GB, and there is no region_of_interest", nodes, dense);
    if (condensed <= fmin(MUCH, share))
        return choose(about, INVERSE_CONDENSED, "region of %d nodes: %.3g GB; dense would take %.3g GB", roi, condensed, dense);
    return choose(about, INVERSE_SPARSE, "region of %d nodes: condensed would take %.3g GB, more than %.3g GB; dense %.3g GB", roi,
                  condensed, fmin(MUCH, share), dense);
}
