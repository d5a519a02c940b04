#include "replay/vtu.h"

#include "common/messages.h"
#include "shared/output.h"

/* ---- the format -------------------------------------------------------------------------------------------------- */

enum { VTK_POLY_LINE = 4, VTK_TRIANGLE = 5, VTK_TETRA = 10 };

static void end_file(FILE *out) { fprintf(out, "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"); }

static void begin_array(const char *type, const char *name, int components, FILE *out) {
    fprintf(out, "<DataArray type=\"%s\" Name=\"%s\" NumberOfComponents=\"%d\" format=\"ascii\">\n", type, name, components);
}

static void end_array(FILE *out) { fprintf(out, "</DataArray>\n"); }

/* Converts one kind of quantity to patient coordinates: mesh_to_patient for positions, lengths_to_patient or axes_to_patient for vectors. */
typedef vec3 (*conversion)(const patient_frame *patient, vec3 v);

static void write_vector(const double v[3], const patient_frame *patient, conversion convert, FILE *out) {
    vec3 x = convert(patient, v3(v[0], v[1], v[2]));
    fprintf(out, "%.17g %.17g %.17g", x.x, x.y, x.z);
}

static void write_vectors(const char *name, const double *v, int count, const patient_frame *patient, conversion convert, FILE *out) {
    begin_array("Float64", name, 3, out);
    for (int i = 0; i < count; i++) {
        write_vector(v + 3 * i, patient, convert, out);
        fputc('\n', out);
    }
    end_array(out);
}

static void write_field_vector(const char *name, const double v[3], const patient_frame *patient, conversion convert, FILE *out) {
    fprintf(out, "<DataArray type=\"Float64\" Name=\"%s\" NumberOfComponents=\"3\" NumberOfTuples=\"1\" format=\"ascii\">", name);
    write_vector(v, patient, convert, out);
    fprintf(out, "</DataArray>\n");
}

static void write_points(const double *points, int count, const patient_frame *patient, FILE *out) {
    fprintf(out, "<Points>\n");
    write_vectors("Points", points, count, patient, mesh_to_patient, out);
    fprintf(out, "</Points>\n");
}

/* ---- tissue ------------------------------------------------------------------------------------------------------ */

static void write_tets(const trocar_refined_mesh *m, FILE *out) {
    fprintf(out, "<Cells>\n");
    begin_array("Int32", "connectivity", 1, out);
    for (int e = 0; e < m->tet_count; e++)
        fprintf(out, "%d %d %d %d\n", m->tets[4 * e], m->tets[4 * e + 1], m->tets[4 * e + 2], m->tets[4 * e + 3]);
    end_array(out);
    begin_array("Int32", "offsets", 1, out);
    for (int e = 1; e <= m->tet_count; e++) fprintf(out, "%d\n", 4 * e);
    end_array(out);
    begin_array("UInt8", "types", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%d\n", VTK_TETRA);
    end_array(out);
    fprintf(out, "</Cells>\n");
}

static void write_tissue_points(const trocar_model *model, const trocar_refined_mesh *m, const patient_frame *patient, FILE *out) {
    fprintf(out, "<PointData Vectors=\"displacement\">\n");
    write_vectors("displacement", m->displacements, m->node_count, patient, lengths_to_patient, out);
    write_vectors("applied_force", m->forces, m->node_count, patient, axes_to_patient, out);
    begin_array("UInt8", "fixed", 1, out);
    for (int i = 0; i < m->node_count; i++) fprintf(out, "%d\n", i < trocar_model_node_count(model) && trocar_model_fixed(model)[i]);
    end_array(out);
    fprintf(out, "</PointData>\n");
}

static void write_tissue_cells(const trocar_model *model, const trocar_refined_mesh *m, FILE *out) {
    const int32_t *regions = trocar_model_tet_regions(model);
    fprintf(out, "<CellData Scalars=\"region\">\n");
    begin_array("Int32", "region", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%d\n", regions[m->parents[e]]);
    end_array(out);
    begin_array("Float64", "youngs_modulus", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%.17g\n", trocar_model_material(model, regions[m->parents[e]]).youngs_modulus);
    end_array(out);
    begin_array("Float64", "poisson_ratio", 1, out);
    for (int e = 0; e < m->tet_count; e++) fprintf(out, "%.17g\n", trocar_model_material(model, regions[m->parents[e]]).poisson_ratio);
    end_array(out);
    if (trocar_model_averages_strain(model)) { /* the nodes over which the volumetric strain of each cell is averaged */
        begin_array("Int32", "volumetric_nodes", 4, out);
        for (int e = 0; e < m->tet_count; e++) {
            const int32_t *corners = trocar_model_tets(model) + 4 * m->parents[e];
            fprintf(out, "%d %d %d %d\n", corners[0], corners[1], corners[2], corners[3]);
        }
        end_array(out);
    }
    const int32_t *patches = trocar_model_strain_patches(model);
    if (patches) {
        begin_array("Int32", "volumetric_patch", 1, out);
        for (int e = 0; e < m->tet_count; e++) fprintf(out, "%d\n", patches[m->parents[e]]);
        end_array(out);
    }
    fprintf(out, "</CellData>\n");
}

/* Writes the names of the regions as a comment, with '-' replaced with '_', because an XML comment may not contain "--". */
static void write_region_names(const trocar_model *model, FILE *out) {
    fprintf(out, "<!-- regions:");
    for (int g = 0; g < trocar_model_region_count(model); g++) {
        if (trocar_model_region_dimension(model, g) != 3) continue;
        fprintf(out, " %d ", g);
        for (const char *c = trocar_model_region_name(model, g); *c; c++) fputc(*c == '-' ? '_' : *c, out);
    }
    fprintf(out, " -->\n");
}

/* Writes the tissue. The applied forces include the damper at the tip, which slows down tissue that springs back and does not act on the needle. */
static void write_tissue(const trocar_model *model, const trocar_refined_mesh *m, const patient_frame *patient, FILE *out) {
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n<FieldData>\n");
    write_field_vector("tip_damping", m->damping, patient, axes_to_patient, out);
    fprintf(out, "</FieldData>\n<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">\n", m->node_count, m->tet_count);
    write_region_names(model, out);
    write_tissue_points(model, m, patient, out);
    write_tissue_cells(model, m, out);
    write_points(m->nodes, m->node_count, patient, out);
    write_tets(m, out);
    end_file(out);
}

/* ---- membranes --------------------------------------------------------------------------------------------------- */

/* Returns the first surface, from index `from` on, that is a stiff membrane; -1 if there is none. */
static int stiff_surface(const trocar_model *model, int from) {
    for (int g = from; g < trocar_model_region_count(model); g++)
        if (trocar_model_membrane(model, g).stiffness > 0.0) return g;
    return -1;
}

bool vtu_has_membranes(const trocar_model *model) { return stiff_surface(model, 0) >= 0; }

/* A triangle of a membrane. */
typedef struct {
    int place, surface;      /* place: 4 x tetrahedron + face, for the adjacent tetrahedron with the smaller index; -1 after the last triangle */
} membrane_triangle;

static bool has_triangle(const trocar_model *model, membrane_triangle t) {
    int neighbour = trocar_model_neighbours(model)[t.place];
    return (neighbour < 0 || t.place / 4 < neighbour) && trocar_model_face_surfaces(model)[t.place] >> t.surface & 1;
}

/* Returns the triangle after `t`. Start with {-1, stiff_surface(model, 0)}. */
static membrane_triangle next_triangle(const trocar_model *model, membrane_triangle t) {
    for (; t.surface >= 0; t = (membrane_triangle){-1, stiff_surface(model, t.surface + 1)})
        for (t.place++; t.place < 4 * trocar_model_tet_count(model); t.place++)
            if (has_triangle(model, t)) return t;
    return (membrane_triangle){-1, -1};
}

static membrane_triangle first_triangle(const trocar_model *model) { return next_triangle(model, (membrane_triangle){-1, stiff_surface(model, 0)}); }

#define EACH_TRIANGLE(t) (membrane_triangle t = first_triangle(model); t.place >= 0; t = next_triangle(model, t))

/* Writes what follows the triangles' connectivity: offsets and types. */
static void end_triangles(int count, FILE *out) {
    begin_array("Int32", "offsets", 1, out);
    for (int i = 1; i <= count; i++) fprintf(out, "%d\n", 3 * i);
    end_array(out);
    begin_array("UInt8", "types", 1, out);
    for (int i = 0; i < count; i++) fprintf(out, "%d\n", VTK_TRIANGLE);
    end_array(out);
    fprintf(out, "</Cells>\n");
}

static void write_triangles(const trocar_model *model, int count, FILE *out) {
    fprintf(out, "<Cells>\n");
    begin_array("Int32", "connectivity", 1, out);
    for EACH_TRIANGLE(t) {
        const int32_t *corners = trocar_model_tets(model) + t.place / 4 * 4;
        fprintf(out, "%d %d %d\n", corners[(t.place + 1) % 4], corners[(t.place + 2) % 4], corners[(t.place + 3) % 4]);
    }
    end_array(out);
    end_triangles(count, out);
}

static void write_membranes(const trocar_model *model, const trocar_refined_mesh *m, const patient_frame *patient, FILE *out) {
    int nodes = trocar_model_node_count(model), count = 0;
    for EACH_TRIANGLE(t) count++;
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n"
                 "<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">\n<PointData Vectors=\"displacement\">\n", nodes, count);
    write_vectors("displacement", m->displacements, nodes, patient, lengths_to_patient, out);
    fprintf(out, "</PointData>\n<CellData Scalars=\"surface\">\n");
    begin_array("Int32", "surface", 1, out);
    for EACH_TRIANGLE(t) fprintf(out, "%d\n", t.surface);
    end_array(out);
    begin_array("Float64", "stiffness", 1, out);
    for EACH_TRIANGLE(t) fprintf(out, "%.17g\n", trocar_model_membrane(model, t.surface).stiffness);
    end_array(out);
    begin_array("Float64", "poisson_ratio", 1, out);
    for EACH_TRIANGLE(t) fprintf(out, "%.17g\n", trocar_model_membrane(model, t.surface).poisson_ratio);
    end_array(out);
    fprintf(out, "</CellData>\n");
    write_points(m->nodes, nodes, patient, out);
    write_triangles(model, count, out);
    end_file(out);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

static trocar_status open_part(output *file, const char *prefix, const char *part, trocar_error *why) {
    char path[1024];
    if (snprintf(path, sizeof path, "%s-%s.vtu", prefix, part) >= (int)sizeof path)
        return fail(why, TROCAR_BAD_INPUT, "%s: path too long", prefix);
    return output_open(file, path, why);
}

typedef void (*mesh_writer)(const trocar_model *model, const trocar_refined_mesh *m, const patient_frame *patient, FILE *out);

static trocar_status write_part(const trocar_model *model, const trocar_refined_mesh *m, const patient_frame *patient, const char *prefix, const char *part,
                                mesh_writer write, trocar_error *why) {
    output file;
    trocar_status status = open_part(&file, prefix, part, why);
    if (status != TROCAR_OK) return status;
    write(model, m, patient, file.file);
    status = output_commit(&file, why);
    output_abandon(&file);
    return status;
}

trocar_status vtu_write_tissue(const trocar_model *model, trocar_picture *picture, const patient_frame *patient, const char *prefix,
                               trocar_error *why) {
    trocar_refined_mesh mesh;
    trocar_status status = trocar_picture_refined_mesh(picture, &mesh, why);
    if (status == TROCAR_OK) status = write_part(model, &mesh, patient, prefix, "tissue", write_tissue, why);
    return status == TROCAR_OK && vtu_has_membranes(model) ? write_part(model, &mesh, patient, prefix, "membranes", write_membranes, why) : status;
}

/* ---- needle ------------------------------------------------------------------------------------------------------ */

enum { MAX_CENTRELINE = TROCAR_MAX_JOINTS + TROCAR_MAX_POINTS };

typedef struct {
    int count;
    double position[MAX_CENTRELINE][3], force[MAX_CENTRELINE][3]; /* m, points of the centreline; N, force on the needle at each point */
    double arc[MAX_CENTRELINE];
} centreline;

static void append(centreline *c, double arc, const double position[3], const double force_on_tissue[3]) {
    c->arc[c->count] = arc;
    for (int a = 0; a < 3; a++) {
        c->position[c->count][a] = position[a];
        c->force[c->count][a] = -1 * force_on_tissue[a];
    }
    c->count++;
}

/* Collects joints and contact points in order of arc length. If the contact at the tip is at the needle's end, the last joint stands for it. */
static void trace_needle(const trocar_model *model, const trocar_picture *picture, centreline *c) {
    static const double none[3] = {-0.0, -0.0, -0.0}, no_tip[3] = {0};
    const trocar_view *view = trocar_picture_view(picture);
    trocar_contact contacts[TROCAR_MAX_POINTS];
    double joints[TROCAR_MAX_JOINTS][3];
    int count = trocar_view_contacts(view, 0, contacts, TROCAR_MAX_POINTS), last = trocar_model_segments(model), contact = 0;
    double length = trocar_model_needle_length(model), segment = length / last;
    bool tip = count > 0 && contacts[count - 1].kind == TROCAR_CONTACT_TIP && contacts[count - 1].arc == length;
    trocar_view_centreline(view, 0, joints[0], TROCAR_MAX_JOINTS);
    count -= tip;
    c->count = 0;
    for (int joint = 0; joint <= last; joint++) {
        double arc = joint * segment;
        for (; contact < count && (contacts[contact].arc < arc || joint == last); contact++)
            append(c, contacts[contact].arc, contacts[contact].position, contacts[contact].force);
        append(c, arc, joints[joint], joint < last ? none : tip ? contacts[count].force : no_tip);
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

/* Writes the needle. The field data come first, because VTK wants them before the piece. */
static void write_needle(const centreline *c, const double base[3], const trocar_output *given, const patient_frame *patient, FILE *out) {
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n"
                 "<UnstructuredGrid>\n<FieldData>\n");
    write_field_vector("base_position", base, patient, mesh_to_patient, out);
    write_field_vector("base_force", given->force, patient, axes_to_patient, out);
    write_field_vector("base_torque", given->torque, patient, axes_to_patient, out);
    fprintf(out, "</FieldData>\n<Piece NumberOfPoints=\"%d\" NumberOfCells=\"1\">\n", c->count);
    fprintf(out, "<PointData Vectors=\"force\">\n");
    write_vectors("force", c->force[0], c->count, patient, axes_to_patient, out);
    begin_array("Float64", "arc_length", 1, out);
    for (int i = 0; i < c->count; i++) fprintf(out, "%.17g\n", c->arc[i]);
    end_array(out);
    fprintf(out, "</PointData>\n");
    write_points(c->position[0], c->count, patient, out);
    write_line(c->count, out);
    end_file(out);
}

trocar_status vtu_write_needle(const trocar_model *model, const trocar_picture *picture, const trocar_output *given,
                               const patient_frame *patient, const char *prefix, trocar_error *why) {
    output file;
    trocar_status status = open_part(&file, prefix, "needle", why);
    if (status != TROCAR_OK) return status;
    centreline c;
    trace_needle(model, picture, &c);
    write_needle(&c, trocar_view_base(trocar_picture_view(picture), 0).position, given, patient, file.file);
    status = output_commit(&file, why);
    output_abandon(&file);
    return status;
}

/* ---- probe ------------------------------------------------------------------------------------------------------- */

/* points around the probe, and rings along it: the first ring is at the base, the others are along the rounded edge of the tip */
enum { AROUND = 48, ALONG = 16 };

/* Computes the radius and the axial position of a ring (m). The last ring is the edge of the flat part of the tip. */
static void profile(const trocar_probe_shape *s, int ring, double *radius, double *along) {
    double angle = 0.5 * M_PI * (ring - 1) / (ALONG - 2);
    *radius = ring == 0 ? s->radius : s->radius - s->tip_radius * (1 - cos(angle));
    *along = ring == 0 ? 0.0 : s->length - s->tip_radius * (1 - sin(angle));
}

static void write_probe_points(const trocar_probe_shape *s, pose base, const patient_frame *patient, FILE *out) {
    double points[AROUND * ALONG + 1][3];
    for (int i = 0; i < AROUND * ALONG; i++) {
        double radius, along, angle = 2 * M_PI * (i % AROUND) / AROUND;
        profile(s, i / AROUND, &radius, &along);
        store_vec3(v3_add(base.position, q_rotate(base.orientation, v3(radius * cos(angle), radius * sin(angle), along))), points[i]);
    }
    store_vec3(v3_add(base.position, q_rotate(base.orientation, v3(0, 0, s->length))), points[AROUND * ALONG]);
    write_points(points[0], AROUND * ALONG + 1, patient, out);
}

/* Writes two triangles for each quadrilateral between neighbouring rings, and a fan of triangles that closes the tip. */
static void write_probe_triangles(bool placed, FILE *out) {
    int rings = placed ? ALONG - 1 : 0, count = placed ? (2 * rings + 1) * AROUND : 0;
    fprintf(out, "<Cells>\n");
    begin_array("Int32", "connectivity", 1, out);
    for (int i = 0; i < rings * AROUND; i++) {
        int next = i % AROUND == AROUND - 1 ? i + 1 - AROUND : i + 1;
        fprintf(out, "%d %d %d\n%d %d %d\n", i, next, i + AROUND, next, next + AROUND, i + AROUND);
    }
    for (int i = 0; placed && i < AROUND; i++) fprintf(out, "%d %d %d\n", rings * AROUND + i, rings * AROUND + (i + 1) % AROUND, AROUND * ALONG);
    end_array(out);
    end_triangles(count, out);
}

static void write_probe(const trocar_probe_shape *shape, const trocar_probe *p, const patient_frame *patient, FILE *out) {
    pose base = load_pose(p->base.position, p->base.orientation);
    bool placed = p->placed != 0;
    quat turn = turn_to_patient(patient, base.orientation);
    fprintf(out, "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n<FieldData>\n");
    write_field_vector("base_position", p->base.position, patient, mesh_to_patient, out);
    fprintf(out, "<DataArray type=\"Float64\" Name=\"orientation\" NumberOfComponents=\"4\" NumberOfTuples=\"1\" format=\"ascii\">%.17g %.17g %.17g %.17g</DataArray>\n",
            turn.w, turn.x, turn.y, turn.z);
    write_field_vector("hand_force", p->force, patient, axes_to_patient, out);
    write_field_vector("hand_torque", p->torque, patient, axes_to_patient, out);
    fprintf(out, "<DataArray type=\"Int32\" Name=\"contacts\" NumberOfTuples=\"1\" format=\"ascii\">%d</DataArray>\n", p->contacts);
    fprintf(out, "</FieldData>\n<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">\n", placed ? AROUND * ALONG + 1 : 0, placed ? (2 * ALONG - 1) * AROUND : 0);
    if (placed) write_probe_points(shape, base, patient, out);
    else write_points(NULL, 0, patient, out);
    write_probe_triangles(placed, out);
    end_file(out);
}

trocar_status vtu_write_probe(const trocar_model *model, const trocar_picture *picture, const patient_frame *patient, const char *prefix,
                              trocar_error *why) {
    trocar_probe_shape shape;
    output file;
    if (!trocar_model_probe(model, &shape)) return TROCAR_OK;
    trocar_status status = open_part(&file, prefix, "probe", why);
    if (status != TROCAR_OK) return status;
    trocar_probe p = trocar_view_probe(trocar_picture_view(picture));
    write_probe(&shape, &p, patient, file.file);
    status = output_commit(&file, why);
    output_abandon(&file);
    return status;
}
