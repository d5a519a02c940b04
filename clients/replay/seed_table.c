#include "replay/seed_table.h"

#include "common/messages.h"

#include <stdlib.h>

void hole_name(const trocar_guide *guide, int hole, char name[16]) {
    int column = hole % guide->columns, row = hole / guide->columns;
    char letters[3] = {(char)('A' + column % 26)};
    if (column >= 26) letters[0] = (char)('A' + column / 26 - 1), letters[1] = (char)('A' + column % 26);
    snprintf(name, 16, "%s%d%s", letters, 1 + row / 2, row % 2 ? ".5" : "");
}

static void write_place(FILE *file, const patient_frame *frame, const double position[3], const double direction[3]) {
    vec3 at = mesh_to_patient(frame, load_vec3(position)), along = axes_to_patient(frame, load_vec3(direction));
    fprintf(file, ",%.9g,%.9g,%.9g,%.9g,%.9g,%.9g", at.x, at.y, at.z, along.x, along.y, along.z);
}

static void write_row(FILE *file, const trocar_scene *scene, const trocar_model *model, const patient_frame *frame, int number, const trocar_seed *s,
                      const double *displacements) {
    char key[64], guide[256] = "", hole[16] = "";
    if (s->guide >= 0) {
        trocar_guide plate = trocar_model_guide(model, s->guide);
        snprintf(key, sizeof key, "guides[%d].name", s->guide);
        trocar_scene_get(scene, key, guide, sizeof guide, NULL);
        hole_name(&plate, s->hole, hole);
    }
    double position[3], direction[3];
    trocar_model_displace_seed(model, displacements, s, position, direction);
    fprintf(file, "%d,%d,%s,%s,%d", number, s->needle, guide, hole, s->strand);
    write_place(file, frame, position, direction);
    write_place(file, frame, s->position, s->direction);
    fputc('\n', file);
}

trocar_status seed_table_write(FILE *file, const trocar_scene *scene, const trocar_model *model, trocar_sim *sim, const patient_frame *frame,
                               trocar_error *why) {
    static trocar_seed seeds[TROCAR_MAX_SEEDS];
    const char *unit = patient_unit(frame);
    double *displacements = malloc(3 * (size_t)trocar_model_node_count(model) * sizeof *displacements);
    if (!displacements) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements");
    trocar_status status = trocar_view_displacements(trocar_sim_view(sim), displacements, why);
    if (status == TROCAR_OK) {
        fprintf(file, "seed,needle,guide,hole,strand,x [%s],y [%s],z [%s],along_x,along_y,along_z,rest_x [%s],rest_y [%s],rest_z [%s],rest_along_x,"
                "rest_along_y,rest_along_z\n", unit, unit, unit, unit, unit, unit);
        int count = trocar_view_seeds(trocar_sim_view(sim), seeds, TROCAR_MAX_SEEDS);
        for (int i = 0; i < count; i++) write_row(file, scene, model, frame, i + 1, &seeds[i], displacements);
    }
    free(displacements);
    return status;
}
