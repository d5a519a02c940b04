#include "organs.h"

#include <stdlib.h>
#include <string.h>

#include "common/messages.h"
#include "view/stream/model_faces.h"

int organs_count(const trocar_model *model) {
    int count = 0;
    for (int r = 0; r < trocar_model_region_count(model); r++) count += trocar_model_region_dimension(model, r) == 3;
    return count;
}

/* Finds the points and triangles on the surface of a volume, for its message. place: scratch memory with one entry per node, all -1 on entry and on
   return. */
static bool make_organ(const trocar_model *model, int region, organ *o, int32_t *place) {
    const int32_t *tets = trocar_model_tets(model), *regions = trocar_model_tet_regions(model);
    int tet_count = trocar_model_tet_count(model), triangles = 0, next = 0;
    for (int t = 0; t < tet_count; t++)
        for (int f = 0; f < 4 && regions[t] == region; f++) triangles += face_bounds_region(model, t, f);
    uint32_t *polygons = malloc((4 * (size_t)triangles + 1) * sizeof *polygons);
    o->nodes = malloc((3 * (size_t)triangles + 1) * sizeof *o->nodes);
    o->points = malloc((9 * (size_t)triangles + 1) * sizeof *o->points);
    bool made = polygons && o->nodes && o->points;
    for (int t = 0; t < tet_count && made; t++)
        for (int f = 0; f < 4 && regions[t] == region; f++) {
            if (!face_bounds_region(model, t, f)) continue;
            polygons[next++] = 3;
            for (int c = 0; c < 3; c++) {
                int32_t node = tets[4 * t + FACE_CORNERS[f][c]];
                if (place[node] < 0) o->nodes[place[node] = o->count++] = node;
                polygons[next++] = (uint32_t)place[node];
            }
        }
    for (int i = 0; i < o->count; i++) place[o->nodes[i]] = -1;
    made = made && igtl_make_surface(o->message, o->count, triangles, polygons);
    free(polygons);
    return made;
}

static void name_organ(igtl_message *messages, int index, const char *name) {
    igtl_message *m = &messages[index];
    igtl_name(m, "POLYDATA", name);
    for (int i = 0; i < index; i++)
        if (strcmp(messages[i].name, m->name) == 0) snprintf(m->name + IGTL_HEADER_NAME_SIZE - 2, 3, "%02u", (unsigned)index % 100);
}

trocar_status organs_make(const trocar_model *model, organ *organs, igtl_message *messages, trocar_error *why) {
    size_t nodes = (size_t)trocar_model_node_count(model);
    int32_t *place = malloc(nodes * sizeof *place);
    bool made = place != NULL;
    if (made) memset(place, -1, nodes * sizeof *place);
    for (int r = 0, i = 0; r < trocar_model_region_count(model) && made; r++) {
        if (trocar_model_region_dimension(model, r) != 3) continue;
        organs[i].message = &messages[i];
        name_organ(messages, i, trocar_model_region_name(model, r));
        made = make_organ(model, r, &organs[i++], place);
    }
    free(place);
    return made ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the organs' surfaces");
}

void organs_free(organ *organs, int count) {
    for (int i = 0; i < count; i++) {
        free(organs[i].nodes);
        free(organs[i].points);
    }
}

void organ_move(organ *o, int64_t utime, const patient_frame *frame, const double *nodes) {
    for (int i = 0; i < o->count; i++) {
        vec3 place = mesh_to_patient(frame, load_vec3(nodes + 3 * (size_t)o->nodes[i]));
        o->points[3 * i] = (float)place.x;
        o->points[3 * i + 1] = (float)place.y;
        o->points[3 * i + 2] = (float)place.z;
    }
    igtl_move_points(o->message, utime, o->points, o->count);
}
