#include "shared/template_holes.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/messages.h"

int find_template(const trocar_model *model) {
    for (int i = 0; i < trocar_model_guide_count(model); i++) {
        trocar_guide guide = trocar_model_guide(model, i);
        if (guide.columns * guide.rows > 1) return i;
    }
    return -1;
}

bool find_hole(const trocar_guide *guide, const char *name, int *column, int *row) {
    char letters[3];
    int number, end = 0;
    if (sscanf(name, "%2[A-Za-z]%2d%n", letters, &number, &end) != 2) return false;
    for (char *letter = letters; *letter; letter++) *letter = (char)toupper((unsigned char)*letter);
    bool half = strcmp(name + end, ".5") == 0;
    if (!half && name[end] != 0 && strcmp(name + end, ".0") != 0) return false;
    *column = letters[1] ? 26 * (letters[0] - 'A' + 1) + letters[1] - 'A' : letters[0] - 'A';
    *row = 2 * (number - 1) + half;
    return *column < guide->columns && *row >= 0 && *row < guide->rows;
}

/* Returns the rotation that takes z to `axis` and x to `along`, which must be perpendicular unit vectors. */
static quat frame_of(vec3 axis, vec3 along) {
    vec3 z = v3(0, 0, 1), turn = v3_cross(z, axis);
    double sine = v3_norm(turn), angle = atan2(sine, v3_dot(z, axis));
    quat tilted = q_exp(sine > 1e-12 ? v3_scale(angle / sine, turn) : v3(angle, 0, 0));
    double roll = atan2(v3_dot(along, q_rotate(tilted, v3(0, 1, 0))), v3_dot(along, q_rotate(tilted, v3(1, 0, 0))));
    return q_unit(q_multiply(tilted, q_exp(v3(0, 0, roll))));
}

pose hole_entry(const trocar_guide *guide, double column, double row) {
    vec3 columns = load_vec3(guide->across[0]), rows = load_vec3(guide->across[1]), normal = load_vec3(guide->normal);
    vec3 place = v3_axpy((column - 0.5 * (guide->columns - 1)) * guide->spacing, columns, load_vec3(guide->origin));
    place = v3_axpy((row - 0.5 * (guide->rows - 1)) * guide->spacing, rows, place);
    return (pose){place, frame_of(normal, v3_cross(rows, normal))};
}
