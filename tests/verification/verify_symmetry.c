/* Checks that a scene rotated and shifted together with its mesh gives the same wrench in its own frame, and that a mirrored scene gives the mirrored
   wrench. The mesh is written to a new file, so that reading, search trees and refinement work with different numbers. */
#include "lockstep.h"
#include "rows.h"

static const double TICK = 1e-3; /* s */
enum { MOST_TICKS = 4000 };

/* The map x -> linear x + shift, where `linear` is a rotation, possibly after a reflection of x. */
typedef struct {
    mat3 linear;
    vec3 shift;
    bool mirrored;
} placing;

static vec3 place_point(const placing *p, vec3 x) { return v3_add(m3_apply(&p->linear, x), p->shift); }

/* Returns the frame of a mirrored needle. Its local x axis is mirrored as well, so that the frame stays right-handed. */
static pose place_pose(const placing *p, pose at) {
    const mat3 mirror = {{{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    mat3 frame = q_matrix(at.orientation);
    frame = m3_multiply(&p->linear, &frame);
    if (p->mirrored) frame = m3_multiply(&frame, &mirror);
    vec3 x = v3(frame.m[0][0], frame.m[1][0], frame.m[2][0]), y = v3(frame.m[0][1], frame.m[1][1], frame.m[2][1]);
    vec3 z = v3_cross(x, y);
    /* Returns the quaternion whose matrix has these columns, computed from its largest component (Shepperd 1978). */
    double t[4] = {1 + x.x + y.y + z.z, 1 + x.x - y.y - z.z, 1 - x.x + y.y - z.z, 1 - x.x - y.y + z.z};
    int k = 0;
    for (int i = 1; i < 4; i++)
        if (t[i] > t[k]) k = i;
    quat q[4] = {{t[0], y.z - z.y, z.x - x.z, x.y - y.x}, {y.z - z.y, t[1], x.y + y.x, z.x + x.z},
                 {z.x - x.z, x.y + y.x, t[2], y.z + z.y}, {x.y - y.x, z.x + x.z, y.z + z.y, t[3]}};
    return (pose){place_point(p, at.position), q_unit(q[k])};
}

/* Copies a mesh in MSH format 2.2, transforming the node positions. */
static void place_mesh(const placing *p, const char *from, const char *to) {
    FILE *in = fopen(from, "r"), *out = fopen(to, "w");
    char line[512];
    int left = -1; /* nodes still to be read, or -1 outside the node section */
    if (!in || !out) {
        perror(in ? to : from);
        exit(2);
    }
    while (fgets(line, sizeof line, in)) {
        vec3 x;
        int number;
        if (left > 0 && sscanf(line, "%d %lf %lf %lf", &number, &x.x, &x.y, &x.z) == 4) {
            x = place_point(p, x);
            snprintf(line, sizeof line, "%d %.17g %.17g %.17g\n", number, x.x, x.y, x.z);
            left--;
        } else if (left == 0) {
            left = -1;
        }
        fputs(line, out);
        if (strncmp(line, "$Nodes", 6) == 0 && fgets(line, sizeof line, in)) {
            left = atoi(line);
            fputs(line, out);
        }
    }
    fclose(in);
    fclose(out);
}

/* Returns the pose of a tilted, bevelled needle that is pushed in, moved sideways and rolled, and pulled back. */
static pose hand_at(double t) {
    double in = fmin(t / 1.0, 1.0), aside = fmin(fmax((t - 1.0) / 0.3, 0.0), 1.0), out = fmin(fmax((t - 1.3) / 0.5, 0.0), 1.0);
    quat lean = q_multiply(q_exp(v3(0.05, -0.08, 0)), q_exp(v3(0, 0, 0.6 + 0.5 * aside)));
    vec3 axis = q_rotate(lean, v3(0, 0, 1)), entry = v3(0.0071, 0.0043, 0.0);
    double along = -0.201 + 0.061 * in - 0.03 * out;
    return (pose){v3_add(v3_axpy(along, axis, entry), v3_scale(aside, v3(0.002, 0.004, 0))), lean};
}

typedef struct {
    int ticks;
    vec3 force[MOST_TICKS], torque[MOST_TICKS]; /* force: N; torque: N m; in the original scene's frame */
} trace;

static trace *play(const rows *r, const placing *p) {
    trace *t = calloc(1, sizeof *t);
    simulation_config c = lockstep_config();
    char path[sizeof c.mesh_path];
    snprintf(path, sizeof path, "%s/placed.msh", r->folder);
    place_mesh(p, c.mesh_path, path);
    memcpy(c.mesh_path, path, sizeof path);
    c.needle.bevel_slope = 0.05;
    lockstep *l = lockstep_create(&c, place_pose(p, hand_at(0)));
    t->ticks = r->short_form ? 900 : 1800;
    for (int i = 0; i < t->ticks; i++) {
        lockstep_tick(l, place_pose(p, hand_at((i + 1) * TICK)), TICK);
        t->force[i] = m3_apply_transposed(&p->linear, l->wrench.force);
        t->torque[i] = v3_scale(p->mirrored ? -1.0 : 1.0, m3_apply_transposed(&p->linear, l->wrench.torque)); /* an axial vector */
    }
    lockstep_free(l);
    remove(path);
    return t;
}

/* Returns the largest difference in any tick, relative to the largest value. */
static double difference(int ticks, const vec3 *a, const vec3 *b) {
    double worst = 0.0, size = 0.0;
    for (int i = 0; i < ticks; i++) {
        worst = fmax(worst, v3_norm(v3_sub(a[i], b[i])));
        size = fmax(size, v3_norm(b[i]));
    }
    return worst / size;
}

static void check_placing(rows *r, const char *what, const trace *plain, const placing *p) {
    trace *t = play(r, p);
    char check[160];
    snprintf(check, sizeof check, "%s: force over %d ticks", what, t->ticks);
    rows_error(r, check, "the plain scene", difference(t->ticks, t->force, plain->force), 1e-6);
    snprintf(check, sizeof check, "%s: torque", what);
    rows_error(r, check, "the plain scene", difference(t->ticks, t->torque, plain->torque), 1e-6);
    free(t);
}

static placing turned(vec3 rotation, vec3 shift) { return (placing){q_matrix(q_exp(rotation)), shift, false}; }

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: rigid-body invariance and mirror symmetry");
    placing plain = turned(v3(0, 0, 0), v3(0, 0, 0)), mirror = {{{{-1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, {0, 0, 0}, true};
    placing shifted = turned(v3(0, 0, 0), v3(0.31, -0.22, 1.7)), quarter = turned(v3(M_PI / 2, 0, 0), v3(0, 0, 0));
    placing slanted = turned(v3(0.7, -1.1, 2.0), v3(-0.4, 0.2, 0.1)), upside = turned(v3(1.9, 2.2, -0.4), v3(0.05, 2.0, -3.0));
    trace *reference = play(&r, &plain);
    check_placing(&r, "turned by 2.4 rad, shifted by 0.5 m", reference, &slanted);
    check_placing(&r, "mirrored in x", reference, &mirror);
    if (!r.short_form) {
        check_placing(&r, "shifted by 1.7 m", reference, &shifted);
        check_placing(&r, "turned by a quarter", reference, &quarter);
        check_placing(&r, "turned by 2.9 rad, shifted by 3.6 m", reference, &upside);
        mirror.linear = m3_multiply(&slanted.linear, &mirror.linear);
        mirror.shift = slanted.shift;
        check_placing(&r, "mirrored, turned and shifted", reference, &mirror);
    }
    free(reference);
    return rows_end(&r);
}
