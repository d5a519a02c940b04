#include "vtu.h"

#include <stdlib.h>

#include "output.h"

/* ---- the format -------------------------------------------------------------------------------------------------- */

enum { VTK_POLY_LINE = 4, VTK_TETRA = 10 };

static void end_file(FILE *out) { fprintf(out, "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"); }

static void begin_array(const char *type, const char *name, int components, FILE *out) {
    fprintf(out, "<DataArray type=\"%s\" Name=\"%s\" NumberOfComponents=\"%d\" format=\"ascii\">\n", type, name, components);
}

static void end_array(FILE *out) { fprintf(out, "</DataArray>\n"); }

static void write_vectors(const char *name, const vec3 *v, int count, FILE *out) {
    begin_array("Float64", name, 3, out);
    for (int i = 0; i < count; i++) fprintf(out, "%.17g %.17g %.17g\n", v[i].x, v[i].y, v[i].z);
    end_array(out);
}

static void write_field_vector(const char *name, vec3 v, FILE *out) {
    fprintf(out, "<DataArray type=\"Float64\" Name=\"%s\" NumberOfComponents=\"3\" NumberOfTuples=\"1\" format=\"ascii\">"
                 "%.17g %.17g %.17g</DataArray>\n", name, v.x, v.y, v.z);
}

static void write_points(const vec3 *points, int count, FILE *out) {
    fprintf(out, "<Points>\n");
    write_vectors("Points", points, count, out);
    fprintf(out, "</Points>\n");
}

/* ---- tissue ------------------------------------------------------------------------------------------------------ */

/* The refined mesh with its loads; arrays of mesh.node_count: nominal nodes, then the added ones. */
typedef struct {
    refined_mesh mesh;
    vec3 *force, *displacement;
} tissue_export;

static void tissue_export_free(tissue_export *e) {
    refined_mesh_free(&e->mesh);
    free(e->force);
    free(e->displacement);
}

static trocar_status tissue_export_create(simulation *s, const insertion_state *state, tissue_export *e, report *why) {
    *e = (tissue_export){0};
    size_t nominal = (size_t)s->mesh.node_count, room = nominal + MAX_CONTACTS;
    e->force = calloc(room, sizeof *e->force);
    e->displacement = calloc(room, sizeof *e->displacement);
    if (!e->force || !e->displacement) return fail(why, TROCAR_NO_MEMORY, "no memory to export %zu nodes", room);
    refinement refined;
    insertion_refinement(state, &refined);
    insertion_forces(&s->insertion, state, e->force, e->force + nominal);
    simulation_displacement(s, state, e->displacement, e->displacement + nominal);
    return refined_mesh_create(&s->mesh, &refined, &e->mesh, why);
}

static void write_tets(const refined_mesh *m, FILE *out) {
    fprintf(out, "<Cells>\n");
    begin_array("Int32", "connectivity", 1, out);
    for (int e = 0; e < m->tet_count; e++)
        fprintf(out, "%d %d %d %d\n", m->tets[e][0], m->tets[e][1], m->tets[e][2], m->tets[e][3]);
    end_array(out);
    begin_array("Int32", "offsets", 1, out);
    for (int e = 1; e <= m->tet_count; e++) fprintf(out, "%d\n", 4 * e);
    end_array(out);
    begin_array("UInt8", "types", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%d\n", VTK_TETRA);
    end_array(out);
    fprintf(out, "</Cells>\n");
}

static void write_tissue_points(const simulation *s, const tissue_export *e, FILE *out) {
    fprintf(out, "<PointData Vectors=\"displacement\">\n");
    write_vectors("displacement", e->displacement, e->mesh.node_count, out);
    write_vectors("applied_force", e->force, e->mesh.node_count, out);
    begin_array("UInt8", "fixed", 1, out);
    for (int i = 0; i < e->mesh.node_count; i++) fprintf(out, "%d\n", i < s->mesh.node_count && s->tissue.fixed[i]);
    end_array(out);
    fprintf(out, "</PointData>\n");
}

static void write_tissue_cells(const simulation *s, const refined_mesh *m, FILE *out) {
    fprintf(out, "<CellData Scalars=\"region\">\n");
    begin_array("Int32", "region", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%d\n", s->mesh.region[m->parent[e]]);
    end_array(out);
    begin_array("Float64", "youngs_modulus", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%.17g\n", s->materials[s->mesh.region[m->parent[e]]].youngs_modulus);
    end_array(out);
    begin_array("Float64", "poisson_ratio", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%.17g\n", s->materials[s->mesh.region[m->parent[e]]].poisson_ratio);
    end_array(out);
    if (s->tissue.volumetric == STRAIN_BY_NODE) { /* the nodes onto which each cell's volumetric strain is averaged */
        begin_array("Int32", "volumetric_nodes", 4, out);
        for (int e = 0; e < m->tet_count; e++) {
            const int *corners = s->mesh.tets[m->parent[e]];
            fprintf(out, "%d %d %d %d\n", corners[0], corners[1], corners[2], corners[3]);
        }
        end_array(out);
    }
    fprintf(out, "</CellData>\n");
}

/* No name can end the comment early: XML forbids "--" there. */
static void write_region_names(const mesh *m, FILE *out) {
    fprintf(out, "<!-- regions:");
    for (int g = 0; g < m->group_count; g++) {
        if (m->groups[g].dimension != 3) continue;
        fprintf(out, " %d ", g);
        for (const char *c = m->groups[g].name; *c; c++) fputc(*c == '-' ? '_' : *c, out);
    }
    fprintf(out, " -->\n");
}

/* What springs back at the tip is held back by a damper that the needle does not feel: part of the applied forces. */
static void write_tissue(const simulation *s, const tissue_export *e, vec3 damping, FILE *out) {
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n<FieldData>\n");
    write_field_vector("tip_damping", damping, out);
    fprintf(out, "</FieldData>\n<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">\n", e->mesh.node_count, e->mesh.tet_count);
    write_region_names(&s->mesh, out);
    write_tissue_points(s, e, out);
    write_tissue_cells(s, &e->mesh, out);
    write_points(e->mesh.nodes, e->mesh.node_count, out);
    write_tets(&e->mesh, out);
    end_file(out);
}

static trocar_status open_part(output *file, const char *prefix, const char *part, report *why) {
    char path[1024];
    if (snprintf(path, sizeof path, "%s-%s.vtu", prefix, part) >= (int)sizeof path)
        return fail(why, TROCAR_BAD_INPUT, "%s: path too long", prefix);
    return output_open(file, path, why);
}

trocar_status vtu_write_tissue(simulation *s, const insertion_state *state, const char *prefix, report *why) {
    output file;
    trocar_status status = open_part(&file, prefix, "tissue", why);
    if (status != TROCAR_OK) return status;
    tissue_export e;
    status = tissue_export_create(s, state, &e, why);
    if (status == TROCAR_OK) {
        write_tissue(s, &e, state->tip.damping, file.file);
        status = output_commit(&file, why);
    }
    tissue_export_free(&e);
    output_abandon(&file);
    return status;
}

/* ---- needle ------------------------------------------------------------------------------------------------------ */

enum { MAX_CENTRELINE = NEEDLE_MAX_SEGMENTS + 1 + MAX_CONTACTS };

typedef struct {
    int count;
    vec3 position[MAX_CENTRELINE], force[MAX_CENTRELINE];
    double arc[MAX_CENTRELINE];
} centreline;

static void append(centreline *c, double arc, vec3 position, vec3 force) {
    c->arc[c->count] = arc;
    c->position[c->count] = position;
    c->force[c->count++] = force;
}

/* Joints and contact points, merged by arc length. */
static void trace_needle(const needle_model *model, const insertion_state *state, centreline *c) {
    int contact = 0, last = model->given.segments;
    c->count = 0;
    for (int joint = 0; joint <= last; joint++) {
        double arc = joint * model->segment_length;
        for (; contact < state->active && (state->contacts[contact].arc < arc || joint == last); contact++) {
            const shaft_contact *at = &state->contacts[contact];
            append(c, at->arc, needle_at(model, &state->needle, at->arc).position, v3_scale(-1, at->force));
        }
        append(c, arc, state->needle.joints[joint], joint == last ? v3_scale(-1, state->tip.force) : v3(0, 0, 0));
    }
}

static void write_line(int count, FILE *out) {
    fprintf(out, "<Cells>\n");
    begin_array("Int32", "connectivity", 1, out);
    for (int i = 0; i < count; i++) fprintf(out, "%d\n", i);
    end_array(out);
    begin_array("Int32", "offsets", 1, out);
    fprintf(out, "%d\n", count);
    end_array(out);
    begin_array("UInt8", "types", 1, out);
    fprintf(out, "%d\n", VTK_POLY_LINE);
    end_array(out);
    fprintf(out, "</Cells>\n");
}

/* VTK wants field data before the piece. */
static void write_needle(const centreline *c, vec3 base, const insertion_wrench *wrench, FILE *out) {
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n"
                 "<UnstructuredGrid>\n<FieldData>\n");
    write_field_vector("base_position", base, out);
    write_field_vector("base_force", wrench->force, out);
    write_field_vector("base_torque", wrench->torque, out);
    fprintf(out, "</FieldData>\n<Piece NumberOfPoints=\"%d\" NumberOfCells=\"1\">\n", c->count);
    fprintf(out, "<PointData Vectors=\"force\">\n");
    write_vectors("force", c->force, c->count, out);
    begin_array("Float64", "arc_length", 1, out);
    for (int i = 0; i < c->count; i++) fprintf(out, "%.17g\n", c->arc[i]);
    end_array(out);
    fprintf(out, "</PointData>\n");
    write_points(c->position, c->count, out);
    write_line(c->count, out);
    end_file(out);
}

trocar_status vtu_write_needle(const simulation *s, const insertion_state *state, const insertion_wrench *wrench,
                               const char *prefix, report *why) {
    output file;
    trocar_status status = open_part(&file, prefix, "needle", why);
    if (status != TROCAR_OK) return status;
    centreline c;
    trace_needle(&s->needle, state, &c);
    write_needle(&c, state->needle.base.position, wrench, file.file);
    status = output_commit(&file, why);
    output_abandon(&file);
    return status;
}
