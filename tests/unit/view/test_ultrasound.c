/* Compares the ultrasound images with theory: speckle statistics (Rayleigh), decorrelation when the tissue moves or is strained, motion with the tissue, the
   width of a point's echo at each depth, and needles, boundaries and shadows. The formulas are implemented separately here and share no code with the
   images. */
#include "view/ultrasound/echo.h"

#include <stdlib.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

/* ---- a block of tissue, 60 mm in each direction, whose front is at y = 0 ---- */

enum { CELLS = 6, SIDE = CELLS + 1, NODES = SIDE * SIDE * SIDE, TETS = 6 * CELLS * CELLS * CELLS };

typedef struct {
    trocar_scene *scene;
    trocar_model *model;
    echo *image;
    image_plane plane;
    image_raster raster;
    unsigned char *levels;
    double nodes[3 * NODES];
} rig;

static const double FACE = 0.01, WAVELENGTH = 1540 / 5.66e6; /* m */

static vec3 node_of(const double *nodes, int n) { return v3(nodes[3 * n], nodes[3 * n + 1], nodes[3 * n + 2]); }

/* Returns the scene of a block. `before`, `behind`: names of the regions before and beyond a depth of 30 mm; `slope`: slope of the boundary between them. */
static trocar_scene *block_scene(const char *before, const char *behind, double slope) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    static double nodes[3 * NODES];
    static int32_t tets[4 * TETS], region[TETS], back[3 * TETS], surface[TETS];
    const char *const names[] = {before, behind}, *const surfaces[] = {"back"};
    int faces = 0;
    for (int n = 0; n < NODES; n++) {
        double x = 0.01 * (n % SIDE) - 0.03, y = 0.01 * (n / SIDE % SIDE), z = 0.01 * (n / SIDE / SIDE);
        bool middle = n / SIDE % SIDE == CELLS / 2;
        nodes[3 * n] = x, nodes[3 * n + 1] = y + (middle ? slope * x : 0), nodes[3 * n + 2] = z;
    }
    for (int t = 0; t < TETS; t++) {
        int cell = t / 6, at[3] = {cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS};
        region[t] = at[1] >= CELLS / 2;
        for (int corner = 0; corner < 4; corner++) {
            tets[4 * t + corner] = at[0] + SIDE * (at[1] + SIDE * at[2]);
            if (corner < 3) at[orders[t % 6][corner]]++;
        }
        if (tets[4 * t + 1] < SIDE * SIDE * CELLS) continue;
        memcpy(back + 3 * faces++, tets + 4 * t + 1, 3 * sizeof *back); /* if the first step is along z, the last three corners are at the top */
    }
    trocar_mesh mesh = {.node_count = NODES, .tet_count = TETS, .nodes = nodes, .tets = tets, .tet_region = region, .region_count = 2, .regions = names,
                        .triangle_count = faces, .triangles = back, .triangle_surface = surface, .surface_count = 1, .surfaces = surfaces};
    trocar_scene *scene;
    trocar_error why;
    assert_int_equal(trocar_scene_create(&scene, &why), TROCAR_OK);
    if (trocar_scene_set_mesh(scene, &mesh, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_int_equal(trocar_scene_set(scene, "fixed", "[back]", &why), TROCAR_OK);
    for (int i = 0; i < 2; i++) {
        char key[64];
        snprintf(key, sizeof key, "regions[%s].youngs_modulus", names[i]);
        assert_int_equal(trocar_scene_set_number(scene, key, 20e3, &why), TROCAR_OK);
    }
    return scene;
}

typedef struct { const char *centre, *radius; } calcification; /* m, as in a scene */

static rig *create_layers(const char *before, const char *behind, double slope, double density, bool sector, const calcification *stone) {
    rig *r = calloc(1, sizeof *r);
    trocar_error why;
    const trocar_model_options mesh_only = {.mesh_only = 1};
    r->scene = block_scene(before, behind, slope);
    if (stone) assert_int_equal(trocar_scene_set(r->scene, "calcifications[0].centre", stone->centre, &why), TROCAR_OK);
    if (stone) assert_int_equal(trocar_scene_set(r->scene, "calcifications[0].radius", stone->radius, &why), TROCAR_OK);
    if (trocar_model_create(r->scene, &mesh_only, &r->model, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_int_equal(echo_create(r->scene, r->model, &TRANSRECTAL, density, &r->image, &why), TROCAR_OK);
    image_field field = {.sector = sector, .near = FACE, .far = FACE + 0.055, .face = FACE, .side = sector ? 0.6 : 0.02};
    r->plane = (image_plane){v3(0, -FACE, 0.03), {v3(1, 0, 0), v3(0, 1, 0), v3(0, 0, 1)}};
    r->raster = image_raster_of(&field, 0.25e-3);
    assert_int_equal(echo_frame(r->image, &field, &r->raster, &why), TROCAR_OK);
    r->levels = malloc((size_t)(r->raster.width * r->raster.height));
    memcpy(r->nodes, trocar_model_nodes(r->model), sizeof r->nodes);
    return r;
}

static rig *create(const char *behind, double slope, double density, bool sector, const calcification *stone) {
    return create_layers("prostate", behind, slope, density, sector, stone);
}

static void release(rig *r) {
    echo_free(r->image);
    trocar_model_free(r->model);
    trocar_scene_free(r->scene);
    free(r->levels);
    free(r);
}

/* Computes the image. `copy` receives a copy of the envelope, which the caller frees. */
static echo_envelope draw(rig *r, const echo_body *bodies, int count, float **copy) {
    echo_image(r->image, &r->plane, r->nodes, bodies, count, r->levels);
    echo_envelope e = echo_last(r->image);
    size_t size = (size_t)(e.rows * e.lines) * sizeof **copy;
    *copy = malloc(size);
    memcpy(*copy, e.values, size);
    return e;
}

static int row_at(const echo_envelope *e, double depth) { return (int)lrint((FACE + depth - e->first_row) / e->step); }

static int by_size(const void *a, const void *b) { return (*(const float *)a > *(const float *)b) - (*(const float *)a < *(const float *)b); }

/* ---- statistics ---- */

typedef struct {
    double snr, distance, critical; /* snr: mean / standard deviation of the amplitude; distance: Kolmogorov-Smirnov distance of the intensity from the
                                       exponential distribution; critical: its limit */
} statistics;

/* Measures the speckle at every fifth row and line, where samples are nearly independent, at depths over which the beam hardly changes. */
static statistics measure(double density) {
    statistics s = {0};
    static float intensity[200000];
    int count = 0;
    double sum = 0, squares = 0, fourth = 0;
    rig *r = create("gland", 0, density, false, NULL);
    for (int k = 0; k < 4; k++) { /* four planes, further apart than the beam is thick */
        float *copy;
        r->plane.origin.z = 0.012 + 0.012 * k;
        echo_envelope e = draw(r, NULL, 0, &copy);
        for (int row = row_at(&e, 0.01); row < row_at(&e, 0.05); row += 5)
            for (int line = 12; line < e.lines - 12; line += 5) {
                double a = copy[row * e.lines + line];
                intensity[count++] = (float)(a * a);
                sum += a, squares += a * a, fourth += a * a * a * a;
            }
        free(copy);
    }
    release(r);
    double mean = sum / count, power = squares / count;
    s.snr = mean / sqrt(power - mean * mean);
    qsort(intensity, (size_t)count, sizeof *intensity, by_size);
    for (int i = 0; i < count; i++) {
        double expected = 1 - exp(-intensity[i] / power);
        s.distance = fmax(s.distance, fmax(fabs(expected - (double)i / count), fabs(expected - (i + 1.0) / count)));
    }
    s.critical = 1.25 / sqrt(count); /* 1 %, for an exponential distribution whose mean is estimated (Lilliefors 1969) */
    print_message("density %.2g/mm3: %d samples, mean power %.3f, SNR %.3f, K-S distance %.4f, critical %.4f\n", 1e-9 * density, count, power, s.snr, s.distance, s.critical);
    return s;
}

/* The amplitude of fully developed speckle has a Rayleigh distribution: mean / standard deviation = sqrt(pi / (4 - pi)) = 1.913. */
static void speckle_is_fully_developed(void **unused) {
    (void)unused;
    statistics s = measure(ECHO_DENSITY);
    assert_close(s.snr, sqrt(M_PI / (4 - M_PI)), 0.05);
    assert_true(s.distance < s.critical);
}

/* The same check shows that too few scatterers do not give a Rayleigh distribution. */
static void sparse_scatterers_are_found_out(void **unused) {
    (void)unused;
    statistics s = measure(ECHO_DENSITY / 40);
    assert_true(s.snr < 1.7);
    assert_true(s.distance > 2 * s.critical);
}

/* ---- the beam ---- */

/* The next functions return the standard deviations (m) of a Gaussian beam in width, thickness and depth, from the formulas for its apertures and bandwidth.
   At the focus, for example, the intensity is a squared sinc whose full width at half maximum is 0.886 times the wavelength times the f-number. */
static double width_of(double depth) {
    double one_way = sqrt(2) * 0.8859 * WAVELENGTH / 2.3548, sent = hypot(one_way * depth / 8e-3, 8e-3 / sqrt(12) * (1 - depth / 0.03));
    double received = one_way * fmax(3.8, depth / 8e-3);
    return sent * received / hypot(sent, received);
}
static double thickness_of(double depth) { return hypot(1.2067 * WAVELENGTH * depth / 4e-3 / 2.3548, 4e-3 / sqrt(12) * (1 - depth / 0.03)) / sqrt(2); }
static double pulse_of(void) { return 1540 / 2.0 / (2 * M_PI * 0.62 * 5.66e6 / 2.3548); }

/* Draws tiny bodies in the plane of an image without scatterers. */
static echo_envelope draw_points(rig *r, const double (*at)[3], int count, float **copy) {
    double ends[8][2][3];
    echo_body bodies[8];
    for (int i = 0; i < count; i++) {
        for (int end = 0; end < 2; end++) ends[i][end][0] = at[i][0], ends[i][end][1] = at[i][1], ends[i][end][2] = at[i][2] + (end ? 5e-5 : -5e-5);
        bodies[i] = (echo_body){ends[i][0], 2, 5e-5, &STEEL};
    }
    return draw(r, bodies, count, copy);
}

/* Returns the standard deviation (m) of the echo along a row, from the parabola through the logarithms of the largest amplitude and of two around it. */
static double measured_sigma(const echo_envelope *e, const float *copy, int row) {
    const float *at = copy + row * e->lines;
    int best = 0, apart = 2;
    for (int line = 0; line < e->lines; line++)
        if (at[line] > at[best]) best = line;
    return apart * e->spacing / sqrt(2 * log(at[best]) - log(at[best - apart]) - log(at[best + apart]));
}

static void a_point_is_as_wide_as_the_beam_at_each_depth(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, false, NULL);
    for (double depth = 0.008; depth < 0.052; depth += 0.0063) {
        float *copy;
        const double at[1][3] = {{0.0003, depth, 0.03}};
        echo_envelope e = draw_points(r, at, 1, &copy);
        double width = 2.3548 * measured_sigma(&e, copy, row_at(&e, depth)), expected = 2.3548 * width_of(depth); /* at -6 dB */
        print_message("depth %.1f mm: width %.3f mm, theory %.3f mm\n", 1e3 * depth, 1e3 * width, 1e3 * expected);
        assert_close(width, expected, 0.05 * expected);
        free(copy);
    }
    release(r);
}

/* Two points side by side are resolved if they are further apart than the beam is wide. */
static void two_points_are_resolved_as_theory_says(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, false, NULL);
    for (double depth = 0.01; depth < 0.05; depth += 0.013)
        for (int apart = 0; apart < 2; apart++) {
            double gap = (apart ? 1.3 : 0.7) * 2.3548 * width_of(depth), lowest = INFINITY, highest = 0;
            float *copy;
            const double at[2][3] = {{-gap / 2, depth, 0.03}, {gap / 2, depth, 0.03}};
            echo_envelope e = draw_points(r, at, 2, &copy);
            for (int line = 0; line < e.lines; line++) {
                double place = e.first_line + line * e.spacing, value = copy[row_at(&e, depth) * e.lines + line];
                if (fabs(place) < 0.12 * gap + 0.5 * e.spacing) lowest = fmin(lowest, value);
                highest = fmax(highest, value);
            }
            assert_true(apart ? lowest < 0.85 * highest : lowest > 0.97 * highest);
            free(copy);
        }
    release(r);
}

/* ---- decorrelation ---- */

typedef struct {
    double n, a, b, aa, bb, ab;
} correlation;

static void add(correlation *c, double amplitude, double other) {
    double a = amplitude * amplitude, b = other * other;
    c->n++, c->a += a, c->b += b, c->aa += a * a, c->bb += b * b, c->ab += a * b;
}
static double result(const correlation *c) {
    return (c->n * c->ab - c->a * c->b) / sqrt((c->n * c->aa - c->a * c->a) * (c->n * c->bb - c->b * c->b));
}

/* Returns the correlation of the intensity, in a narrow range of depths, before and after the tissue moves (m). */
static double correlation_after(rig *r, vec3 motion, double depth) {
    correlation c = {0};
    for (int k = 0; k < 6; k++) {
        float *before, *after;
        r->plane.origin.z = 0.008 + 0.0085 * k;
        draw(r, NULL, 0, &before);
        for (int n = 0; n < NODES; n++) r->nodes[3 * n] += motion.x, r->nodes[3 * n + 1] += motion.y, r->nodes[3 * n + 2] += motion.z;
        echo_envelope e = draw(r, NULL, 0, &after);
        memcpy(r->nodes, trocar_model_nodes(r->model), sizeof r->nodes);
        for (int row = row_at(&e, depth - 0.003); row < row_at(&e, depth + 0.003); row++)
            for (int line = 20; line < e.lines - 20; line++) add(&c, before[row * e.lines + line], after[row * e.lines + line]);
        free(before);
        free(after);
    }
    return result(&c);
}

/* The correlation of a Gaussian beam's echo with itself after a shift d is exp(-d^2 / (4 s^2)). That of the speckle's intensity is the square of this. */
static void speckle_decorrelates_with_motion_as_theory_says(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 4 * ECHO_DENSITY, false, NULL);
    const double depth = 0.025;
    const struct {
        const char *name;
        vec3 direction;
        double sigma;
    } cases[] = {{"away from the probe", {0, 1, 0}, pulse_of()}, {"across the image", {1, 0, 0}, width_of(depth)}, {"out of the plane", {0, 0, 1}, thickness_of(depth)}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        for (double part = 0.5; part <= 2; part += 0.5) {
            double found = correlation_after(r, v3_scale(part * cases[i].sigma, cases[i].direction), depth), expected = exp(-0.5 * part * part);
            print_message("%s, %.1f sigma: correlation %.3f, theory %.3f\n", cases[i].name, part, found, expected);
            assert_close(found, expected, 0.04);
        }
    release(r);
}

/* Stretching the tissue along the beam by a fraction e about a point changes the phases within the pulse at that point. For small e, the correlation of the
   intensity is exp(-2 (k s e)^2), with k = 2 pi / wavelength. The full expression also allows for the pulse being (1 + e) times as long as in the undeformed
   tissue. */
static void check_strain(double density, double tolerance) {
    rig *r = create("gland", 0, density, false, NULL);
    double k = 2 * M_PI / WAVELENGTH, s = pulse_of();
    for (double strain = 0.1; strain < 0.35; strain += 0.1) {
        correlation c = {0};
        for (int plane = 0; plane < 6; plane++) {
            float *before, *after;
            r->plane.origin.z = 0.008 + 0.0085 * plane;
            echo_envelope e = draw(r, NULL, 0, &before);
            for (int step = 0; step < 24; step++) { /* stretches the tissue about one fixed point after another */
                int row = row_at(&e, 0.015 + 0.001 * step);
                double fixed = e.first_row + row * e.step - FACE;
                for (int n = 0; n < NODES; n++) r->nodes[3 * n + 1] += strain * (r->nodes[3 * n + 1] - fixed);
                draw(r, NULL, 0, &after);
                memcpy(r->nodes, trocar_model_nodes(r->model), sizeof r->nodes);
                for (int line = 20; line < e.lines - 20; line++) add(&c, before[row * e.lines + line], after[row * e.lines + line]);
                free(after);
            }
            free(before);
        }
        double q = 1 + (1 + strain) * (1 + strain), found = result(&c);
        double expected = 2 * (1 + strain) / q * exp(-4 * k * k * strain * strain * s * s / q);
        print_message("density %.0f/mm3, strain %.1f: correlation %.3f, theory %.3f\n", 1e-9 * density, strain, found, expected);
        assert_close(found, expected, tolerance);
    }
    release(r);
}

/* The theory assumes infinitely many scatterers. A real image has few enough that single ones remain recognisable, so the tolerance is larger there. */
static void speckle_decorrelates_with_strain_as_theory_says(void **unused) {
    (void)unused;
    check_strain(4 * ECHO_DENSITY, 0.03);
    check_strain(ECHO_DENSITY, 0.07);
}

/* ---- motion ---- */

/* Returns the displacement (m) of the tissue, with which the motion of the speckle is compared. */
static vec3 field_at(vec3 x) { return v3(0.6e-3 * sin(40 * x.y), 0.5e-3 * sin(60 * x.x) + 0.01 * x.y, 0); }

/* Computes the shift, in fractional rows and lines, at which a block of the second image best matches that of the first. */
static void track(const echo_envelope *e, const float *before, const float *after, int row, int line, double *down, double *right) {
    enum { HALF_ROWS = 20, HALF_LINES = 9, REACH_ROWS = 18, REACH_LINES = 4 };
    static double score[2 * REACH_ROWS + 1][2 * REACH_LINES + 1];
    int best[2] = {REACH_ROWS, REACH_LINES};
    for (int i = -REACH_ROWS; i <= REACH_ROWS; i++)
        for (int j = -REACH_LINES; j <= REACH_LINES; j++) {
            correlation c = {0};
            for (int a = -HALF_ROWS; a <= HALF_ROWS; a++)
                for (int b = -HALF_LINES; b <= HALF_LINES; b++)
                    add(&c, sqrt(before[(row + a) * e->lines + line + b]), sqrt(after[(row + a + i) * e->lines + line + b + j]));
            score[i + REACH_ROWS][j + REACH_LINES] = result(&c);
            if (result(&c) > score[best[0]][best[1]]) best[0] = i + REACH_ROWS, best[1] = j + REACH_LINES;
        }
    assert_true(best[0] > 0 && best[0] < 2 * REACH_ROWS && best[1] > 0 && best[1] < 2 * REACH_LINES);
    double top = score[best[0]][best[1]], up = score[best[0] - 1][best[1]], low = score[best[0] + 1][best[1]], l = score[best[0]][best[1] - 1], m = score[best[0]][best[1] + 1];
    *down = best[0] - REACH_ROWS + 0.5 * (up - low) / (up + low - 2 * top);
    *right = best[1] - REACH_LINES + 0.5 * (l - m) / (l + m - 2 * top);
}

static void speckle_moves_with_the_tissue(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, ECHO_DENSITY, false, NULL);
    float *before, *after;
    draw(r, NULL, 0, &before);
    for (int n = 0; n < NODES; n++) {
        vec3 move = field_at(node_of(r->nodes, n));
        r->nodes[3 * n] += move.x, r->nodes[3 * n + 1] += move.y;
    }
    echo_envelope e = draw(r, NULL, 0, &after);
    double across = 0, away = 0, moved = 0;
    int count = 0;
    for (double depth = 0.012; depth < 0.046; depth += 0.004)
        for (double x = -0.014; x < 0.015; x += 0.004) {
            int row = row_at(&e, depth), line = (int)lrint((x - e.first_line) / e.spacing);
            double down, right, weights = 0;
            vec3 at = v3(e.first_line + line * e.spacing, e.first_row + row * e.step - FACE, 0.03), expected = v3(0, 0, 0);
            track(&e, before, after, row, line, &down, &right);
            for (int n = 0; n < NODES; n++) { /* trilinear interpolation between the nodes; that of the tetrahedra differs little from it */
                vec3 rest = node_of(trocar_model_nodes(r->model), n), from = v3_scale(100, v3_sub(at, rest));
                double w = fmax(0, 1 - fabs(from.x)) * fmax(0, 1 - fabs(from.y)) * fmax(0, 1 - fabs(from.z));
                expected = v3_axpy(w, field_at(rest), expected);
                weights += w;
            }
            assert_close(weights, 1, 1e-6);
            across += pow(right * e.spacing - expected.x, 2);
            away += pow(down * e.step - expected.y, 2);
            moved += v3_dot(expected, expected);
            count++;
        }
    print_message("%d blocks: error %.3f mm across, %.3f mm away from the probe; motion %.3f mm (root mean squares)\n", count, 1e3 * sqrt(across / count), 1e3 * sqrt(away / count),
                  1e3 * sqrt(moved / count));
    assert_true(sqrt(across / count) < 0.08e-3);
    assert_true(sqrt(away / count) < 0.03e-3);
    free(before);
    free(after);
    release(r);
}

/* ---- needles, boundaries, shadows ---- */

static double largest(const echo_envelope *e, const float *copy, double from, double to) {
    double most = 0;
    for (int i = row_at(e, from) * e->lines; i < row_at(e, to) * e->lines; i++) most = fmax(most, copy[i]);
    return most;
}

/* A needle parallel to the image plane is visible from beside it, too, with the brightness that follows from the beam's thickness. */
static void a_needle_beside_the_plane_is_seen(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, false, NULL);
    double ends[2][3] = {{-0.03, 0.02, 0.03}, {0.03, 0.02, 0.03}}, in_plane = 0;
    const echo_body thin = {ends[0], 2, 5e-5, &STEEL};
    for (double aside = 0; aside < 2.5e-3; aside += 0.4e-3) {
        float *copy;
        r->plane.origin.z = 0.03 + aside;
        echo_envelope e = draw(r, &thin, 1, &copy);
        double echo = largest(&e, copy, 0.019, 0.021), expected = exp(-0.5 * pow(aside / thickness_of(0.02), 2));
        if (aside == 0) in_plane = echo;
        assert_close(echo / in_plane, expected, 0.03);
        free(copy);
    }
    assert_true(in_plane > 2);
    release(r);
}

/* The echoes behind a needle are spaced by a round trip through the steel, which in the image is the diameter x 1540 / 5790. Tested without speckle, with a
   thick needle. */
static void a_needle_reverberates(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, false, NULL);
    double ends[2][3] = {{0, 0.02, 0}, {0, 0.02, 0.06}}, radius = 3e-3, pitch = 2 * radius * 1540 / 5790;
    const echo_body thick = {ends[0], 2, radius, &STEEL};
    float *copy;
    echo_envelope e = draw(r, &thick, 1, &copy);
    int line = e.lines / 2;
    double depths[4], echoes[4];
    int peaks[4] = {0};
    for (int k = 0; k < 4; k++)
        for (int row = row_at(&e, 0.02 - radius + (k - 0.4) * pitch); row < row_at(&e, 0.02 - radius + (k + 0.4) * pitch); row++)
            if (copy[row * e.lines + line] > copy[peaks[k] * e.lines + line]) peaks[k] = row;
    for (int k = 0; k < 4; k++) { /* the logarithm of the pulse is a parabola */
        double before = log(copy[(peaks[k] - 1) * e.lines + line]), at = log(copy[peaks[k] * e.lines + line]), after = log(copy[(peaks[k] + 1) * e.lines + line]);
        double shift = 0.5 * (before - after) / (before + after - 2 * at);
        depths[k] = (peaks[k] + shift) * e.step;
        echoes[k] = exp(at - 0.25 * (before - after) * shift);
    }
    for (int k = 1; k < 4; k++) assert_close(depths[k] - depths[0], k * pitch, 0.5 * e.step);
    print_message("echoes %.3f %.4f %.4f %.4f\n", echoes[0], echoes[1], echoes[2], echoes[3]);
    double steel = (45.7 - 1.63) / (45.7 + 1.63);
    assert_close(echoes[1] / echoes[0], 1 - steel * steel, 0.02);
    assert_close(echoes[3] / echoes[2], steel * steel, 0.08);
    free(copy);
    release(r);
}

/* A boundary reflects most where the sound hits it at a right angle. It is modelled as facets whose slopes vary by 0.35, and scatters 15 % in all
   directions. The echo of an oblique boundary is also spread over the depths that the beam's width covers. */
static void a_boundary_reflects_by_angle(void **unused) {
    (void)unused;
    double straight = 0;
    for (double slope = 0; slope < 0.25; slope += 0.08) {
        rig *r = create("fat", slope, 1, false, NULL);
        float *copy;
        echo_envelope e = draw(r, NULL, 0, &copy);
        double echo = 0, spread = slope * width_of(0.03) / pulse_of(), expected = (0.15 + 0.85 * exp(-0.5 * pow(slope / 0.35, 2))) / sqrt(1 + spread * spread);
        for (int row = row_at(&e, 0.025); row < row_at(&e, 0.035); row++) echo = fmax(echo, copy[row * e.lines + e.lines / 2]);
        if (slope == 0) straight = echo;
        print_message("slope %.2f: echo %.3f, theory %.3f\n", slope, echo / straight, expected);
        assert_close(echo / straight, expected, 0.05);
        free(copy);
        release(r);
    }
    double organs = (1.65 - 1.39) / (1.65 + 1.39);
    assert_close(straight, pow(10, 45 / 20.0) * organs, 0.1 * pow(10, 45 / 20.0) * organs);
}

/* Returns the echo of a needle in the image plane with this slope, on the middle line and 20 mm deep: the mean over depths that differ by fractions of a row, on
   which it depends a little. The needle is so thick that its reverberations lie apart from the echo. */
static double echo_of_needle(rig *r, double slope) {
    enum { DEPTHS = 8 };
    double sum = 0;
    for (int k = 0; k < DEPTHS; k++) {
        double depth = 0.021 + k * echo_last(r->image).step / DEPTHS, ends[2][3] = {{-0.02, depth - 0.02 * slope, 0.03}, {0.02, depth + 0.02 * slope, 0.03}}, echo = 0;
        const echo_body thick = {ends[0], 2, 1e-3, &STEEL};
        float *copy;
        echo_envelope e = draw(r, &thick, 1, &copy);
        for (int row = row_at(&e, 0.018); row < row_at(&e, 0.022); row++) echo = fmax(echo, copy[row * e.lines + e.lines / 2]);
        sum += echo / DEPTHS;
        free(copy);
    }
    return sum;
}

/* A needle reflects most where it is at a right angle to the sound. Its surface is modelled as facets whose slopes vary by 0.15, and scatters 3 % in all
   directions. The echo of an oblique needle is also spread over the depths that the beam's width covers. */
static void a_needle_reflects_by_angle(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, false, NULL);
    double straight = echo_of_needle(r, 0);
    for (double slope = 0.1; slope < 0.35; slope += 0.1) {
        double echo = echo_of_needle(r, slope) / straight, spread = slope * width_of(0.02) / pulse_of();
        double expected = (0.03 + 0.97 * exp(-0.5 * pow(slope / 0.15, 2))) / sqrt(1 + spread * spread);
        print_message("needle with slope %.1f: echo %.3f, theory %.3f\n", slope, echo, expected);
        assert_close(echo, expected, 0.03);
    }
    release(r);
}

static double mean_power(const echo_envelope *e, const float *copy, double x, double from, double to) {
    double sum = 0;
    int count = 0, line = (int)lrint((x - e->first_line) / e->spacing);
    for (int row = row_at(e, from); row < row_at(e, to); row++)
        for (int l = line - 1; l <= line + 1; l++) sum += pow(copy[row * e->lines + l], 2), count++;
    return sum / count;
}

/* The image is dark behind a large calcification, behind a needle that crosses the plane, and in urine. */
static void there_are_shadows(void **unused) {
    (void)unused;
    float *copy;
    rig *r = create("gland", 0, ECHO_DENSITY, false, &(calcification){"[0.005, 0.015, 0.03]", "2e-3"});
    double ends[2][3] = {{-0.008, 0.012, 0}, {-0.008, 0.012, 0.06}};
    const echo_body needle = {ends[0], 2, 0.635e-3, &STEEL};
    echo_envelope e = draw(r, &needle, 1, &copy);
    assert_true(mean_power(&e, copy, 0.005, 0.02, 0.05) < 1e-3);
    assert_true(mean_power(&e, copy, -0.008, 0.035, 0.05) < 0.2);
    assert_close(mean_power(&e, copy, -0.001, 0.02, 0.05), 1, 0.35);
    free(copy);
    release(r);
    r = create("urine", 0, ECHO_DENSITY, false, NULL);
    e = draw(r, NULL, 0, &copy);
    assert_true(mean_power(&e, copy, 0, 0.035, 0.05) < 0.05);
    free(copy);
    release(r);
}

/* Returns the part of the amplitude that comes back past a calcification in the middle of the plane: there and back, along a line at a distance of `aside` from
   its centre. The part of the beam that hits it loses the energy that both surfaces reflect, and 15 dB/(cm MHz) inside. */
static double left_by_stone(double depth, double radius, double aside) {
    if (aside >= radius) return 1;
    double half = sqrt(radius * radius - aside * aside), part = erf(half / (sqrt(2) * thickness_of(depth - half))), mirrored = (6.5 - 1.63) / (6.5 + 1.63);
    double through = (1 - mirrored * mirrored) * pow(10, -15 * 5.66 * 100 * 2 * half / 20);
    return pow(1 - part * (1 - through), 2);
}

/* Behind a calcification as wide as the beam, the beam's edges pass it: the power is the mean over the lines, weighted with the square of the beam. */
static void the_shadow_of_a_small_calcification_is_as_deep_as_theory_says(void **unused) {
    (void)unused;
    const double radius = 0.7e-3, depth = 0.015, from = 0.025, to = 0.05;
    double expected = 0, power[2];
    echo_envelope e;
    for (int k = 0; k < 2; k++) {
        float *copy;
        rig *r = create("gland", 0, ECHO_DENSITY, false, k ? &(calcification){"[0.005, 0.015, 0.03]", "0.7e-3"} : NULL);
        e = draw(r, NULL, 0, &copy);
        power[k] = mean_power(&e, copy, 0.005, from, to);
        free(copy);
        release(r);
    }
    enum { ROWS = 50, STEPS = 200 };
    for (int i = 0; i < 3 * ROWS; i++) { /* mean_power looks at three lines */
        double line = e.first_line + e.spacing * (lrint((0.005 - e.first_line) / e.spacing) + i % 3 - 1);
        double sum = 0, weights = 0, width = width_of(from + (i / 3 + 0.5) * (to - from) / ROWS);
        for (int k = -STEPS; k <= STEPS; k++) {
            double x = 4.0 * k / STEPS, weight = exp(-x * x);
            sum += weight * pow(left_by_stone(depth, radius, fabs(line + x * width - 0.005)), 2);
            weights += weight;
        }
        expected += sum / weights / (3 * ROWS);
    }
    print_message("behind a calcification of 0.7 mm: power %.4f, theory %.4f\n", power[1] / power[0], expected);
    assert_close(power[1] / power[0], expected, 0.05 * expected);
}

/* Urine attenuates hardly at all (0.0022 dB/(cm MHz)), but the scanner compensates for 0.5, so the image is brighter behind 30 mm of it. */
static void it_is_bright_behind_urine(void **unused) {
    (void)unused;
    double power[2], mirrored = (1.65 - 1.53) / (1.65 + 1.53), expected = pow(10, (0.5 - 0.0022) * 5.66 * 2 * 3 / 10) * pow(1 - mirrored * mirrored, 2);
    for (int k = 0; k < 2; k++) {
        float *copy;
        rig *r = create_layers(k ? "urine" : "prostate", "gland", 0, ECHO_DENSITY, false, NULL);
        echo_envelope e = draw(r, NULL, 0, &copy);
        power[k] = mean_power(&e, copy, 0, 0.035, 0.05);
        free(copy);
        release(r);
    }
    print_message("behind 30 mm of urine: power %.2f, theory %.2f\n", power[1] / power[0], expected);
    assert_close(power[1] / power[0], expected, 0.03 * expected);
}

/* ---- planes and pixels ---- */

static void planes_turn_with_the_probe(void **unused) {
    (void)unused;
    image_planner p = {.has_probe = true, .probe_reach = 0.14, .probe_radius = 0.009};
    image_plane planes[SLICES];
    quat turn = q_exp(v3(0, 0, 0.3));
    planes_at_probe(&p, (pose){v3(0.001, -0.03, -0.08), turn}, planes);
    for (int k = 0; k < SLICES; k++) {
        assert_close_vector(planes[k].origin, v3(0.001, -0.03, 0.06), 1e-12);
        assert_close_vector(planes[k].axes[1], v3(-sin(0.3), cos(0.3), 0), 1e-12); /* rows point away from the probe */
        assert_close_vector(v3_cross(planes[k].axes[0], planes[k].axes[1]), planes[k].axes[2], 1e-12);
    }
    assert_close_vector(planes[SLICE_AXIAL].axes[2], v3(0, 0, 1), 1e-12);
    assert_close_vector(planes[SLICE_SAGITTAL].axes[2], v3(-cos(0.3), -sin(0.3), 0), 1e-12); /* the sagittal plane tilts */
}

static void levels_become_grey(void **unused) {
    (void)unused;
    unsigned char plain[256], louder[256], wider[256];
    for (int i = 0; i < 256; i++) plain[i] = louder[i] = wider[i] = (unsigned char)i;
    echo_show(plain, 256, 0, 60);
    echo_show(louder, 256, 6, 60);
    echo_show(wider, 256, 0, 90);
    assert_true(plain[0] == 0 && louder[0] == 0 && plain[255] == 255);
    int mean = 1 + (int)(60 / 0.4); /* 0 dB */
    assert_true(plain[mean] > 90 && plain[mean] < 150);
    assert_close(louder[mean] - plain[mean], 255 * 6 / 60.0, 1);
    assert_true(wider[mean] > plain[mean] && plain[mean - 150] == 0);
}

/* A sector is black beyond its edges and in front of the transducer's face. */
static void a_sector_has_edges(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, ECHO_DENSITY, true, NULL);
    float *copy;
    draw(r, NULL, 0, &copy);
    for (int j = 0; j < r->raster.height; j++)
        for (int i = 0; i < r->raster.width; i++) {
            double x = r->raster.left + i * r->raster.pixel, y = r->raster.near + j * r->raster.pixel, angle = fabs(atan2(x, y)), range = hypot(x, y);
            bool inside = angle < 0.58 && range > FACE + 1e-3 && range < FACE + 0.054, outside = angle > 0.62 || range < FACE - 1e-3 || range > FACE + 0.056;
            assert_true(!inside || r->levels[j * r->raster.width + i] > 0);
            assert_true(!outside || r->levels[j * r->raster.width + i] == 0);
        }
    free(copy);
    release(r);
}

/* A point appears in the picture where it is, at any angle and range. */
static void a_point_in_a_sector_is_where_it_is(void **unused) {
    (void)unused;
    rig *r = create("gland", 0, 1, true, NULL);
    for (double angle = -0.5; angle < 0.55; angle += 0.25)
        for (double range = 0.02; range < 0.055; range += 0.01) {
            double x = range * sin(angle), away = range * cos(angle), sum = 0, across = 0, up = 0;
            float *copy;
            draw_points(r, (const double[1][3]){{x, away - FACE, 0.03}}, 1, &copy);
            unsigned char most = 0;
            int count = r->raster.width * r->raster.height;
            for (int p = 0; p < count; p++) most = r->levels[p] > most ? r->levels[p] : most;
            for (int p = 0; p < count; p++) {
                double weight = fmax(0, r->levels[p] - (most - 6 / 0.4)); /* within 6 dB of the brightest pixel */
                sum += weight;
                across += weight * (r->raster.left + p % r->raster.width * r->raster.pixel);
                up += weight * (r->raster.near + p / r->raster.width * r->raster.pixel);
            }
            assert_close(across / sum, x, 0.5 * r->raster.pixel);
            assert_close(up / sum, away, 0.5 * r->raster.pixel);
            free(copy);
        }
    release(r);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(speckle_is_fully_developed),
        cmocka_unit_test(sparse_scatterers_are_found_out),
        cmocka_unit_test(a_point_is_as_wide_as_the_beam_at_each_depth),
        cmocka_unit_test(two_points_are_resolved_as_theory_says),
        cmocka_unit_test(speckle_decorrelates_with_motion_as_theory_says),
        cmocka_unit_test(speckle_decorrelates_with_strain_as_theory_says),
        cmocka_unit_test(speckle_moves_with_the_tissue),
        cmocka_unit_test(a_needle_beside_the_plane_is_seen),
        cmocka_unit_test(a_needle_reverberates),
        cmocka_unit_test(a_boundary_reflects_by_angle),
        cmocka_unit_test(a_needle_reflects_by_angle),
        cmocka_unit_test(there_are_shadows),
        cmocka_unit_test(the_shadow_of_a_small_calcification_is_as_deep_as_theory_says),
        cmocka_unit_test(it_is_bright_behind_urine),
        cmocka_unit_test(planes_turn_with_the_probe),
        cmocka_unit_test(levels_become_grey),
        cmocka_unit_test(a_sector_has_edges),
        cmocka_unit_test(a_point_in_a_sector_is_where_it_is),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
