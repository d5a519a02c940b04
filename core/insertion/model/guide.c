#include "insertion/model/guide.h"

#include <math.h>

static const double SKIN_CONTACT = 1e-5; /* m: how far a plate may overlap the tissue, so that it can rest on the skin. Rounding tolerance */
static const double LEAST_SINE = 1e-3; /* dimensionless: smallest sine of the angle between the normal and the columns' direction. Rounding tolerance */
static const double LEAST_SQUARE = 0.7; /* cosine: smallest cosine of the angle between the rows' given direction and the perpendicular to the columns. Chosen:
                                           45 degrees; at a larger angle, the rows would be nearer to the columns' direction */

guide_config guide_defaults(void) {
    return (guide_config){.columns = 1, .rows = 1, .spacing = 5e-3, .thickness = 20e-3, .stiffness = 50e3, .friction = 0.1};
}

/* Returns the unit vector along v; a zero vector stays zero. */
static vec3 direction_of(vec3 v) {
    double largest = fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z)));
    return largest > 0.0 ? v3_unit(v3_scale(1.0 / largest, v)) : v;
}

static bool is_zero(vec3 v) { return v.x == 0.0 && v.y == 0.0 && v.z == 0.0; }

/* Returns a coordinate axis that is not nearly parallel to the normal. A plate with a single hole needs no columns' direction; this axis, projected into the
   plate, takes its place. */
static vec3 some_direction_across(vec3 normal) { return fabs(normal.x) < 0.9 ? v3(1, 0, 0) : v3(0, 1, 0); }

/* Finds the unit vectors along columns and rows. `square`: cosine of the angle between the rows' given direction and the one found. */
static void find_axes(const guide_config *given, vec3 across[2], double *square) {
    vec3 normal = direction_of(given->normal), along = is_zero(given->along) ? some_direction_across(normal) : direction_of(given->along);
    across[0] = v3_unit(v3_axpy(-v3_dot(along, normal), normal, along));
    across[1] = v3_cross(normal, across[0]);
    *square = is_zero(given->rows_along) ? 1.0 : v3_dot(direction_of(given->rows_along), across[1]);
    if (*square >= 0.0) return;
    across[1] = v3_scale(-1.0, across[1]);
    *square = -*square;
}

/* True if the rows' given direction is close enough (LEAST_SQUARE) to the perpendicular to the columns in the plate. The columns' direction must be valid. */
static bool has_square_rows(const guide_config *g) {
    vec3 across[2];
    double square;
    find_axes(g, across, &square);
    return square >= LEAST_SQUARE;
}

/* Checks the directions. Describes the first fault in `text`, or leaves it empty if there is none. Returns the key of the direction checked last. */
static const char *fault_of_directions(const guide_config *g, char *text, size_t size) {
    bool grid = g->columns * g->rows > 1;
    if (is_zero(g->normal)) return snprintf(text, size, "has no direction: give the direction in which needles pass through the plate"), "normal";
    if (grid && is_zero(g->along)) return snprintf(text, size, "missing: a plate of %d x %d holes needs the direction of its columns", g->columns, g->rows), "along";
    if (is_zero(g->along)) return "along";
    if (v3_norm(v3_cross(direction_of(g->normal), direction_of(g->along))) < LEAST_SINE) return snprintf(text, size, "parallel to the normal: give a direction in the plate"), "along";
    if (!has_square_rows(g))
        snprintf(text, size, "not across the columns in the plate: give a direction perpendicular to the normal and to along, or leave it out");
    return "rows_along";
}

const char *guide_fault(const guide_config *g, double needle_diameter, const char **key, trocar_error *words) {
    words->text[0] = '\0';
    *key = fault_of_directions(g, words->text, sizeof words->text);
    if (words->text[0]) return words->text;
    if (g->hole_diameter < needle_diameter)
        *key = "hole_diameter", decimal_print(words->text, sizeof words->text, "a hole of %g m is smaller than the needle's outer diameter of %g m: widen it, or choose a thinner needle",
                                         g->hole_diameter, needle_diameter);
    else if (g->columns * g->rows > 1 && g->spacing < g->hole_diameter)
        *key = "spacing", decimal_print(words->text, sizeof words->text, "holes of %g m overlap at a spacing of %g m", g->hole_diameter, g->spacing);
    return words->text[0] ? words->text : NULL;
}

guide guide_make(const guide_config *given, double needle_diameter) {
    guide g = {.origin = given->origin, .normal = direction_of(given->normal), .columns = given->columns, .rows = given->rows,
               .spacing = given->spacing, .hole_radius = 0.5 * given->hole_diameter, .clearance = 0.5 * (given->hole_diameter - needle_diameter),
               .thickness = given->thickness, .stiffness = given->stiffness, .friction = given->friction};
    double square;
    find_axes(given, g.across, &square);
    return g;
}

/* Returns the distance (m) of a column or row from the middle of the grid. */
static double offset_of(const guide *g, int index, int count) { return g->spacing * (index - 0.5 * (count - 1)); }

vec3 guide_hole(const guide *g, int hole, double depth) {
    vec3 centre = v3_axpy(offset_of(g, hole % g->columns, g->columns), g->across[0], g->origin);
    return v3_axpy(depth, g->normal, v3_axpy(offset_of(g, hole / g->columns, g->rows), g->across[1], centre));
}

int guide_hole_at(const guide *g, vec3 point) {
    vec3 from = v3_sub(point, g->origin);
    const int count[2] = {g->columns, g->rows};
    int nearest[2];
    for (int a = 0; a < 2; a++) {
        double place = v3_dot(from, g->across[a]) / g->spacing + 0.5 * (count[a] - 1);
        if (!(place > -1.0 && place < count[a])) return BESIDE_PLATE;
        nearest[a] = (int)fmin(fmax(floor(place + 0.5), 0.0), count[a] - 1);
    }
    int hole = nearest[0] + g->columns * nearest[1];
    vec3 aside = v3_sub(point, guide_hole(g, hole, 0.0));
    return v3_norm(v3_axpy(-v3_dot(aside, g->normal), g->normal, aside)) <= g->hole_radius ? hole : NO_HOLE;
}

bool guide_is_in_tissue(const guide *g, const mesh *m) {
    for (int hole = 0; hole < g->columns * g->rows; hole++) {
        vec3 front = guide_hole(g, hole, -SKIN_CONTACT), back = guide_hole(g, hole, fmax(g->thickness - SKIN_CONTACT, 0.0));
        if (mesh_locate(m, front, -1) >= 0 || mesh_enter(m, front, back).hit) return true;
    }
    return false;
}
