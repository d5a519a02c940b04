/* Tests trocar-slicer from outside: values in patient coordinates, compared with hand calculations; images, compared with surfaces; slow clients; malformed
   messages; restarts; and trackers. usage: test_slicer TROCAR_SLICER TROCAR_SERVER MESHES CASE (values, faults, slow, trackers or server), in a private
   network namespace */
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <igtlServerSocket.h>
#include <igtl_util.h>
#include <limits>
#include <memory>
#include <set>

#include "client.h"
#include "fake_server.h"
#include "program.h"
#include "trocar.h"

static std::string bridge_path, server_path, meshes, work;

/* ---- the scene: trus.yaml with other patient coordinates ---- */

/* mesh = (head, left, back) / 1000 + (0.01, -0.02, 0.03): the axes are permuted, so that a transposed or mirrored matrix shows up. */
static const char PATIENT[] = "patient_to_mesh: [0, 0, 1e-3, 0.01,   1e-3, 0, 0, -0.02,   0, 1e-3, 0, 0.03,   0, 0, 0, 1]";
static Vector turned_to_ras(const Vector &v) { return {-v[1], -v[2], v[0]}; }
static Vector to_ras(const Vector &m) { return {-1e3 * (m[1] + 0.02), -1e3 * (m[2] - 0.03), 1e3 * (m[0] - 0.01)}; }

static std::string write_scene(const std::string &name = "scene.yaml", const std::string &probe = "") {
    std::ifstream in(meshes + "/trus.yaml");
    std::string path = work + "/" + name, line;
    std::ofstream out(path);
    while (std::getline(in, line)) {
        if (line.rfind("mesh:", 0) == 0) line = "mesh: " + meshes + "/trus.msh";
        if (line.rfind("patient_to_mesh:", 0) == 0) line = PATIENT;
        if (!probe.empty() && line.rfind("  start: {position: [0, -0.032", 0) == 0) line = "  start: {position: " + probe + "}";
        out << line << '\n';
    }
    return path;
}

struct Mesh {
    trocar_scene *scene = nullptr;
    trocar_model *model = nullptr;
    explicit Mesh(const std::string &path) {
        trocar_model_options options = {};
        options.mesh_only = 1;
        trocar_error why;
        bool made = trocar_scene_load(path.c_str(), &scene, &why) == TROCAR_OK && trocar_model_create(scene, &options, &model, &why) == TROCAR_OK;
        EXPECT(made, "%s", why.text);
        if (!made) std::exit(1);
    }
    ~Mesh() {
        trocar_model_free(model);
        trocar_scene_free(scene);
    }
    std::vector<Vector> nodes() const {
        const double *x = trocar_model_nodes(model);
        std::vector<Vector> all;
        for (int i = 0; i < trocar_model_node_count(model); i++) all.push_back({x[3 * i], x[3 * i + 1], x[3 * i + 2]});
        return all;
    }
};

static void set_up(FakeServer &server, const Mesh &mesh) {
    server.nodes = mesh.nodes();
    for (int i = 0; i <= 40; i++) server.centreline.push_back({0.01 + 0.005 * std::min(i, 20), 0.02, 0.03 + 0.005 * std::max(i - 20, 0)}); /* bent by 90° */
    for (double &q : server.orientation) q = 0.5; /* the needle's x, y and z axes are the mesh's y, z and x axes */
    server.tip_lead = 0.5 * M_PI;
    server.force = {1, 2, 3};
    server.probe = {0, -0.032, -0.08};
    server.probe_force = {0, -1.5, 0};
}

static std::vector<std::string> bridge_command(const std::string &scene, std::vector<std::string> more = {}) {
    std::vector<std::string> all = {bridge_path, "--scene", scene, "--port", "0"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
}

static void expect_columns(const Columns &got, const Columns &wanted, double tolerance, const char *what) {
    for (int i = 0; i < 12; i++) EXPECT(std::fabs(got.numbers[i] - wanted.numbers[i]) <= tolerance, "%s, number %d: %g, not %g", what, i, got.numbers[i], wanted.numbers[i]);
}

/* ---- surfaces ---- */

struct Surface {
    std::vector<Vector> points;
    std::vector<std::array<int, 3>> triangles;
    explicit Surface(igtl::PolyDataMessage::Pointer m) {
        for (int i = 0; i < m->GetPoints()->GetNumberOfPoints(); i++) {
            float x[3];
            m->GetPoints()->GetPoint(i, x);
            points.push_back({x[0], x[1], x[2]});
        }
        for (unsigned i = 0; m->GetPolygons() && i < m->GetPolygons()->GetNumberOfCells(); i++) {
            igtlUint32 corners[3];
            EXPECT(m->GetPolygons()->GetCellSize(i) == 3);
            m->GetPolygons()->GetCell(i, corners);
            triangles.push_back({static_cast<int>(corners[0]), static_cast<int>(corners[1]), static_cast<int>(corners[2])});
        }
    }
    double volume() const { /* by the divergence theorem; positive if the faces point outwards */
        double sum = 0;
        for (const auto &t : triangles) {
            const Vector &a = points[t[0]], &b = points[t[1]], &c = points[t[2]];
            sum += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
        }
        return sum / 6;
    }
    /* Returns whether a ray from the point, in a direction parallel to no edge, crosses the surface an odd number of times. */
    bool contains(const Vector &x) const {
        static const Vector along = {0.4358, 0.5123, 0.7399};
        int crossings = 0;
        for (const auto &t : triangles) {
            Vector e, f, s;
            for (int a = 0; a < 3; a++) e[a] = points[t[1]][a] - points[t[0]][a], f[a] = points[t[2]][a] - points[t[0]][a], s[a] = x[a] - points[t[0]][a];
            Vector h = cross(along, f), q = cross(s, e);
            double whole = dot(e, h), u = dot(s, h) / whole, v = dot(along, q) / whole;
            crossings += u >= 0 && v >= 0 && u + v <= 1 && dot(f, q) / whole > 0;
        }
        return crossings % 2;
    }
    static double dot(const Vector &a, const Vector &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
    static Vector cross(const Vector &a, const Vector &b) { return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}; }
};

static const std::vector<std::string> ORGANS = {"prostate", "surrounding", "perineum", "muscle"}; /* organ names, in the order of the scene */

static Vector shear(const Vector &x, double) { return {0.04 * x[2], -0.03 * x[0], 0.05 * x[1] + 0.002}; }

/* Compares the message's volume (mm^3) and points with those of the displaced mesh. */
static void check_surface(const Mesh &mesh, const std::string &name, const Surface &surface) {
    const int32_t *tets = trocar_model_tets(mesh.model), *regions = trocar_model_tet_regions(mesh.model), *neighbours = trocar_model_neighbours(mesh.model);
    int region = trocar_model_find_region(mesh.model, name.c_str(), 3);
    std::vector<Vector> nodes = mesh.nodes();
    std::set<int> wanted;
    double volume = 0;
    for (Vector &x : nodes) {
        Vector u = shear(x, 0);
        x = to_ras({x[0] + u[0], x[1] + u[1], x[2] + u[2]});
    }
    for (int t = 0; t < trocar_model_tet_count(mesh.model); t++) {
        if (regions[t] != region) continue;
        Vector e[3];
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < 3; a++) e[i][a] = nodes[tets[4 * t + i + 1]][a] - nodes[tets[4 * t]][a];
        volume += std::fabs(Surface::dot(e[0], Surface::cross(e[1], e[2]))) / 6;
        for (int f = 0; f < 4; f++)
            for (int i = 0; i < 4; i++)
                if (i != f && (neighbours[4 * t + f] < 0 || regions[neighbours[4 * t + f]] != region)) wanted.insert(tets[4 * t + i]);
    }
    EXPECT(surface.points.size() == wanted.size(), "%s: %zu points, not %zu", name.c_str(), surface.points.size(), wanted.size());
    double furthest = 0;
    for (const Vector &p : surface.points) {
        double nearest = std::numeric_limits<double>::infinity();
        for (int n : wanted) nearest = std::min(nearest, std::hypot(p[0] - nodes[n][0], p[1] - nodes[n][1], p[2] - nodes[n][2]));
        furthest = std::max(furthest, nearest);
    }
    EXPECT(furthest < 1e-3, "%s: %g mm from the mesh", name.c_str(), furthest);
    EXPECT(std::fabs(surface.volume() / volume - 1) < 1e-4, "%s: %g mm^3, not %g", name.c_str(), surface.volume(), volume);
}

/* ---- images ---- */

/* Returns a position as Slicer interprets the message (OpenIGTLinkIO, igtlioConverterUtilities.cxx): an image's position is that of its centre. */
static Vector place_of(igtl::ImageMessage::Pointer m, double i, double j) {
    igtl::Matrix4x4 matrix;
    float spacing[3];
    int size[3];
    m->GetMatrix(matrix);
    m->GetSpacing(spacing);
    m->GetDimensions(size);
    Vector x;
    for (int a = 0; a < 3; a++)
        x[a] = matrix[a][3] + matrix[a][0] * spacing[0] * (i - 0.5 * (size[0] - 1)) + matrix[a][1] * spacing[1] * (j - 0.5 * (size[1] - 1));
    return x;
}

/* Works out from the surfaces which organ contains each pixel's centre. The image must agree, except for pixels on a surface. */
static void check_image(igtl::ImageMessage::Pointer m, const std::vector<Surface> &organs, const char *name) {
    int size[3], differing = 0, further = 0, tissue = 0;
    m->GetDimensions(size);
    const auto *grey = static_cast<const unsigned char *>(m->GetScalarPointer());
    std::vector<int> wanted(size[0] * size[1], 0);
    for (int j = 0; j < size[1]; j++)
        for (int i = 0; i < size[0]; i++)
            for (size_t o = 0; o < organs.size(); o++)
                if (organs[o].contains(place_of(m, i, j))) wanted[j * size[0] + i] = static_cast<int>(o) + 1;
    for (int j = 0; j < size[1]; j++)
        for (int i = 0; i < size[0]; i++) {
            int here = grey[j * size[0] + i];
            tissue += wanted[j * size[0] + i] != 0;
            if (here == wanted[j * size[0] + i]) continue;
            bool beside = false; /* whether an adjacent pixel should have this value */
            for (int y = std::max(0, j - 1); y <= std::min(size[1] - 1, j + 1); y++)
                for (int x = std::max(0, i - 1); x <= std::min(size[0] - 1, i + 1); x++) beside |= wanted[y * size[0] + x] == here;
            differing++;
            further += !beside;
        }
    std::printf("%s: %d x %d pixels, %d in tissue; %d differ from the surfaces, %d of them by more than a voxel\n", name, size[0], size[1], tissue, differing, further);
    EXPECT(tissue > 1000 && std::set<int>(wanted.begin(), wanted.end()).size() >= 3, "%s shows too little to be a test", name);
    EXPECT(further == 0 && differing < tissue / 100, "%s", name);
}

static void test_values() {
    Mesh mesh(write_scene());
    FakeServer server;
    set_up(server, mesh);
    server.displace = shear;
    const double turn[4] = {std::cos(0.15), 0.8 * std::sin(0.15), 0, 0.6 * std::sin(0.15)}; /* the probe is tilted */
    std::copy(turn, turn + 4, server.probe_orientation);
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene), {"--images", "regions", "--pixel", "1"}));
    EXPECT(bridge.ready(), "%s", bridge.errors_text().c_str());
    Client client(bridge.port());
    EXPECT(client.has({"NeedleToReference", "NeedleTipToReference", "NeedleForce", "ProbeToReference", "ProbeForce", "TrocarStatus", "Needle", "AxialImage", "SagittalImage"}));
    client.receive_for(0.5); /* waits until all messages have arrived; they belong to the same frame */
    for (auto &ages : client.ages) EXPECT(ages.second.back() > 0 && ages.second.back() < 1, "%s is %g s old", ages.first.c_str(), ages.second.back());

    expect_columns(client.transform("NeedleToReference"), {{-1, 0, 0, 0, -1, 0, 0, 0, 1, -40, 0, 0}}, 1e-4, "base");
    expect_columns(client.transform("NeedleTipToReference"), {{0, 0, -1, 1, 0, 0, 0, -1, 0, -40, -100, 100}}, 1e-4, "tip, a quarter turn ahead");
    Surface shape(client.surfaces["Needle"]);
    EXPECT(shape.points.size() == 41 && client.surfaces["Needle"]->GetLines()->GetNumberOfCells() == 1 && client.surfaces["Needle"]->GetLines()->GetCellSize(0) == 41);
    for (size_t i = 0; i < std::min<size_t>(41, shape.points.size()); i++)
        for (int a = 0; a < 3; a++) EXPECT(std::fabs(shape.points[i][a] - to_ras(server.centreline[i])[a]) < 1e-4, "point %zu of the needle", i);
    expect_columns(client.transform("NeedleForce"), {{1, 0, 0, 0, 1, 0, 0, 0, 1, -2, -3, 1}}, 1e-6, "force");
    expect_columns(client.transform("ProbeForce"), {{1, 0, 0, 0, 1, 0, 0, 0, 1, 1.5, 0, 0}}, 1e-6, "the probe's force");
    Columns probe = client.transform("ProbeToReference");
    Vector place = {probe.numbers[9], probe.numbers[10], probe.numbers[11]}, axis = {probe.numbers[6], probe.numbers[7], probe.numbers[8]};
    Vector turned = turned_to_ras({2 * (turn[1] * turn[3]), -2 * turn[0] * turn[1], 1 - 2 * turn[1] * turn[1]}); /* third column of the quaternion's rotation
                                                                                                                    matrix, with y = 0 */
    for (int a = 0; a < 3; a++) {
        EXPECT(std::fabs(place[a] - Vector{12, 110, -10}[a]) < 1e-4, "the probe: %g", place[a]);
        EXPECT(std::fabs(axis[a] - turned[a]) < 1e-6, "its axis: %g, not %g", axis[a], turned[a]);
    }
    std::string text = client.text("TrocarStatus");
    for (const char *part : {"\"server\": true", "\"scene\": \"/scenes/a \\u0022b\\u0022.yaml\"", "\"depth_mm\": 12.5", "\"state\": \"held\""})
        EXPECT(text.find(part) != std::string::npos, "%s: no %s", text.c_str(), part);

    std::vector<Surface> organs;
    for (const std::string &name : ORGANS) {
        organs.emplace_back(client.surfaces[name]);
        check_surface(mesh, name, organs.back());
    }
    check_image(client.images["AxialImage"], organs, "axial");
    check_image(client.images["SagittalImage"], organs, "sagittal");

    /* The axial image is perpendicular to the probe's axis, 141 mm from its base: 150 mm minus 9 mm for the tip. */
    int size[3];
    client.images["AxialImage"]->GetDimensions(size);
    for (int j : {0, size[1] - 1})
        for (int i : {0, size[0] - 1}) {
            Vector x = place_of(client.images["AxialImage"], i, j), from = {x[0] - place[0], x[1] - place[1], x[2] - place[2]};
            EXPECT(std::fabs(Surface::dot(from, axis) - 141) < 1e-3, "a corner of the axial image is %g mm along the probe", Surface::dot(from, axis));
        }
    EXPECT(bridge.stop(SIGTERM) == 0);
}

/* As in ultrasound, the gland is darker than the tissue around it, and the needle is a bright spot where it crosses the plane. */
static void test_echo() {
    Mesh mesh(write_scene());
    FakeServer server;
    set_up(server, mesh);
    server.centreline = {{0.005, 0.002, -0.15}, {0.005, 0.002, -0.05}, {0.005, 0.002, 0.07}};
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    Client client(bridge.port());
    EXPECT(client.has({"AxialImage", "prostate", "surrounding", "NeedleToReference"}));
    client.receive_for(0.3);
    Surface prostate(client.surfaces["prostate"]), around(client.surfaces["surrounding"]);
    igtl::ImageMessage::Pointer m = client.images["AxialImage"];
    int size[3], spots = 0;
    m->GetDimensions(size);
    const auto *grey = static_cast<const unsigned char *>(m->GetScalarPointer());
    double sum[2] = {}, count[2] = {};
    Vector needle = to_ras({0.005, 0.002, 0.061}); /* where the needle crosses the plane at z = 61 mm */
    for (int j = 0; j < size[1]; j++)
        for (int i = 0; i < size[0]; i++) {
            Vector x = place_of(m, i, j);
            int value = grey[j * size[0] + i];
            double from = std::hypot(x[0] - needle[0], x[1] - needle[1], x[2] - needle[2]);
            spots += from < 1 && value > 140;
            if (from < 3 || value == 0 || i % 3 || j % 3) continue;
            int kind = prostate.contains(x) ? 0 : around.contains(x) ? 1 : -1;
            if (kind >= 0) sum[kind] += value, count[kind]++;
        }
    EXPECT(count[0] > 100 && count[1] > 100 && sum[0] / count[0] < 0.85 * sum[1] / count[1], "gland %g, around it %g", sum[0] / count[0], sum[1] / count[1]);
    EXPECT(spots >= 2, "%d bright pixels at the needle", spots);
}

/* ---- clients that are slow, wrong, or many ---- */

static std::vector<unsigned char> raw(int version, const char *type, const char *name, std::vector<unsigned char> body, uint64_t size, bool wrong_sum = false) {
    std::vector<unsigned char> bytes(58, 0);
    auto put = [&bytes](size_t at, uint64_t value, int count) {
        for (int i = 0; i < count; i++) bytes[at + i] = static_cast<unsigned char>(value >> 8 * (count - 1 - i));
    };
    put(0, version, 2);
    std::memcpy(&bytes[2], type, std::min<size_t>(12, std::strlen(type)));
    std::memcpy(&bytes[14], name, std::min<size_t>(20, std::strlen(name)));
    put(42, size, 8);
    put(50, crc64(body.data(), body.size(), crc64(nullptr, 0, 0)) + wrong_sum, 8);
    bytes.insert(bytes.end(), body.begin(), body.end());
    return bytes;
}

static std::vector<unsigned char> raw_columns(const Columns &c) {
    std::vector<unsigned char> body;
    for (float number : c.numbers) {
        uint32_t bits;
        std::memcpy(&bits, &number, 4);
        for (int shift = 24; shift >= 0; shift -= 8) body.push_back(static_cast<unsigned char>(bits >> shift));
    }
    return body;
}

static const Columns STYLUS = {{-1, 0, 0, 0, -1, 0, 0, 0, 1, -40, 0, 0}}; /* the transform that puts the needle's base where set_up() puts it */

static void test_slow_client(const Mesh &mesh) {
    FakeServer server;
    set_up(server, mesh);
    server.displace = [](const Vector &x, double t) { return Vector{0.01 * x[2] * std::sin(20 * t), 0, 0}; }; /* every frame differs */
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    Client warm(bridge.port());
    warm.receive_for(0.5);
    long memory = bridge.memory();
    std::vector<std::unique_ptr<Connection>> slow;
    for (int i = 0; i < 3; i++) slow.push_back(std::make_unique<Connection>(bridge.port(), 4096)); /* these clients never read */
    Client client(bridge.port());
    double from = seconds();
    client.receive_for(3);
    double time = seconds() - from;
    for (const char *name : {"NeedleToReference", "NeedleForce", "prostate", "AxialImage"})
        EXPECT(client.counts[name] >= 27 * time && client.counts[name] <= 31 * time + 2, "%s: %g times a second", name, client.counts[name] / time);
    std::vector<double> &ages = client.ages["NeedleToReference"];
    std::sort(ages.begin(), ages.end());
    std::printf("beside clients that never read: %g surfaces a second, needle %.1f ms old at p50, %.1f ms at p99; memory %+ld kB\n", client.counts["prostate"] / time,
                1e3 * ages[ages.size() / 2], 1e3 * ages[ages.size() * 99 / 100], (bridge.memory() - memory) / 1024);
    EXPECT(ages[ages.size() / 2] < 0.02, "needle %g s old", ages[ages.size() / 2]);
#ifndef __SANITIZE_ADDRESS__ /* not under the sanitizer, which does not release freed memory at once */
    EXPECT(bridge.memory() - memory < 16 << 20, "%ld bytes", bridge.memory() - memory);
#endif

    /* One of these clients reads at last: it has missed values, but soon receives the newest ones. */
    int needles = 0;
    double age = 1e9;
    for (double end = seconds() + 10; age > 0.2 && seconds() < end;) {
        unsigned char head[58];
        std::vector<unsigned char> body;
        uint64_t size = 0, stamp = 0;
        if (!slow[0]->receive(head, sizeof head)) break;
        for (int i = 0; i < 8; i++) stamp = stamp << 8 | head[34 + i], size = size << 8 | head[42 + i];
        body.resize(size);
        if (!slow[0]->receive(body.data(), size)) break;
        if (std::strcmp(reinterpret_cast<char *>(head) + 14, "NeedleToReference") != 0) continue;
        needles++;
        age = epoch_seconds() - static_cast<double>(stamp) / 4294967296.0;
    }
    std::printf("a client that reads after 3 s: up to date after %d needle poses\n", needles);
    EXPECT(age <= 0.2, "%g s old", age);
    EXPECT(needles < 60, "%d needle poses of 90", needles);
}

/* Reads messages at this rate, with the system's default receive buffer. The buffer may hold several megabytes, and the bridge must not fill it. */
static void test_slow_reader(const Mesh &mesh, double rate) {
    FakeServer server;
    set_up(server, mesh);
    server.displace = [](const Vector &x, double t) { return Vector{0.01 * x[2] * std::sin(20 * t), 0, 0}; };
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    Connection slow(bridge.port());
    double begin = seconds(), oldest = 0, whole = 0;
    size_t largest = 0;
    std::map<std::string, int> counts;
    while (seconds() < begin + 8) {
        unsigned char head[58], part[16384];
        uint64_t size = 0, stamp = 0;
        EXPECT(slow.receive(head, sizeof head));
        for (int i = 0; i < 8; i++) stamp = stamp << 8 | head[34 + i], size = size << 8 | head[42 + i];
        for (uint64_t left = size; left > 0;) {
            size_t count = std::min<uint64_t>(left, sizeof part);
            EXPECT(slow.receive(part, count));
            left -= count;
            whole += static_cast<double>(count);
            wait(begin + whole / rate - seconds());
        }
        largest = std::max<size_t>(largest, size);
        double age = epoch_seconds() - static_cast<double>(stamp) / 4294967296.0;
        std::string name(reinterpret_cast<char *>(head) + 14, strnlen(reinterpret_cast<char *>(head) + 14, 20));
        counts[name]++;
        if (seconds() > begin + 3 && name != "TrocarStatus") oldest = std::max(oldest, age); /* skips the first seconds, because organs at rest are sent only
                                                                                                once */
    }
    std::printf("a client that reads %.1f MB/s, messages of up to %.2f MB: values at most %.2f s old;", 1e-6 * rate, 1e-6 * static_cast<double>(largest), oldest);
    for (const auto &c : counts) std::printf(" %s %d", c.first.c_str(), c.second);
    std::printf("\n");
    EXPECT(oldest < 0.5 + 3 * static_cast<double>(largest) / rate, "%g s old", oldest);
    EXPECT(counts["prostate"] >= 5 && counts["NeedleToReference"] > 50, "%d surfaces, %d needle poses", counts["prostate"], counts["NeedleToReference"]);
    EXPECT(rate < 1e7 || counts["prostate"] > 150, "%d surfaces in 8 s", counts["prostate"]); /* a client that reads fast enough receives all surfaces */
}

static void test_slow() {
    Mesh mesh(write_scene());
    for (double rate : {0.15e6, 0.5e6, 2e6, 20e6}) test_slow_reader(mesh, rate); /* bytes per second */
}

static void test_garbage(const Mesh &mesh) {
    FakeServer server;
    set_up(server, mesh);
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    Client client(bridge.port());
    const char http[] = "GET / HTTP/1.1\r\nHost: trocar.example.org\r\nAccept: text/html,*/*\r\nConnection: close\r\n\r\n";
    std::vector<unsigned char> noise(100000);
    for (size_t i = 0; i < noise.size(); i++) noise[i] = static_cast<unsigned char>(i * 2654435761u >> 13);
    for (const auto &bytes : {std::vector<unsigned char>(http, http + sizeof http - 1), noise, raw(9, "TRANSFORM", "StylusToReference", {}, 0), raw(1, "IMAGE", "Huge", {}, UINT64_MAX)}) {
        Connection bad(bridge.port());
        bad.send(bytes);
        EXPECT(bad.is_closed());
    }
    EXPECT(bridge.said("sent no OpenIGTLink header: disconnected") && bridge.said("announced a message of more than 256 MB: disconnected"), "%s", bridge.errors_text().c_str());

    /* These messages are skipped, and those after them are accepted. Each is sent on its own connection, because faults are reported at most once per second
       and connection. */
    float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
    std::vector<unsigned char> good = raw_columns(STYLUS);
    struct { std::vector<unsigned char> bytes; const char *said; } faults[] = {
        {raw(1, "TRANSFORM", "StylusToReference", good, 48, true), "\"StylusToReference\" has a wrong checksum"},
        {raw(1, "TRANSFORM", "StylusToReference", {1, 2, 3}, 3), "\"StylusToReference\" has a wrong size"},
        {raw(2, "TRANSFORM", "StylusToReference", {1, 2, 3}, 3), "\"StylusToReference\" is too short"},
        {raw(2, "TRANSFORM", "StylusToReference", std::vector<unsigned char>(60, 255), 60), "\"StylusToReference\" has a wrong size"},
        {raw(1, "TRANSFORM", "StylusToReference", {}, 0), "a TRANSFORM has a wrong size"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{1, 0, 0, 0, 1, 0, 0, 0, 1, nan, 0, 0}}), 48), "has a number that is not finite"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{1, 0, 0, 0, 1, 0, 0, 0, 1, infinity, 0, 0}}), 48), "has a number that is not finite"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{1, 0.1f, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}}), 48), "is not rigid"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{2, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0}}), 48), "is not rigid"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}}), 48), "is not rigid"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{-1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}}), 48), "is left-handed"},
        {raw(1, "TRANSFORM", "StylusToReference", raw_columns({{1, 0, 0, 0, 1, 0, 0, 0, 1, 2e4f, 0, 0}}), 48), "is more than 10 m away"},
        {raw(1, "STT_TDATA", "", std::vector<unsigned char>(36, 7), 36), nullptr},
        {raw(1, "COMMAND", "x", std::vector<unsigned char>(200000, 7), 200000), nullptr},
    };
    std::vector<std::unique_ptr<Connection>> connections;
    for (const auto &fault : faults) {
        connections.push_back(std::make_unique<Connection>(bridge.port()));
        connections.back()->send(fault.bytes);
        if (fault.said) EXPECT(soon([&] { return bridge.said(fault.said); }, 5), "%s is not said in: %s", fault.said, bridge.errors_text().c_str());
    }
    wait(0.1);
    EXPECT(server.poses().empty(), "a faulty matrix moves the needle");
    for (int i : {0, 5, 12, 13}) { /* these connections still accept valid messages; of several senders, the first moves the needle */
        std::vector<unsigned char> whole = raw(1, "TRANSFORM", "StylusToReference", good, 48);
        connections[i]->send({whole.begin(), whole.begin() + 30}); /* in two parts */
        wait(0.02);
        connections[i]->send({whole.begin() + 30, whole.end()});
        if (i == 0) EXPECT(soon([&] { return !server.poses().empty(); }));
    }
    EXPECT(soon([&] { return bridge.said("comes from 127.0.0.1:"); }), "%s", bridge.errors_text().c_str());

    std::vector<std::unique_ptr<Connection>> crowd;
    for (int i = 0; i < 70; i++) crowd.push_back(std::make_unique<Connection>(bridge.port()));
    EXPECT(crowd.back()->is_closed());
    EXPECT(bridge.said("64 are connected already"));
    crowd.clear();
    connections.clear();
    client.counts.clear();
    client.receive_for(1);
    EXPECT(client.counts["NeedleToReference"] >= 25, "%d", client.counts["NeedleToReference"]);
    EXPECT(bridge.stop(SIGTERM) == 0);
}

/* A client that sends version 2 headers gets version 2 headers. A query returns values even if they have not changed. */
static void test_versions(const Mesh &mesh) {
    FakeServer server;
    set_up(server, mesh);
    server.start();
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    std::set<int> answered;
    for (int version : {1, 2}) {
        Connection client(bridge.port());
        wait(0.5); /* by now, the client has received all surfaces */
        client.send(raw(version, "GET_POLYDATA", "prostate", {}, 0));
        int surfaces = 0;
        for (double end = seconds() + 2; seconds() < end && surfaces < 2;) {
            unsigned char head[58];
            uint64_t size = 0, sum = 0;
            if (!client.receive(head, sizeof head)) break;
            for (int i = 0; i < 8; i++) size = size << 8 | head[42 + i], sum = sum << 8 | head[50 + i];
            std::vector<unsigned char> body(size);
            if (!client.receive(body.data(), size)) break;
            EXPECT(sum == crc64(body.data(), size, crc64(nullptr, 0, 0)));
            if (head[1] == 2) {
                const unsigned char extension[12] = {0, 12, 0, 2};
                EXPECT(std::memcmp(body.data(), extension, 12) == 0 && body[size - 1] == 0 && body[size - 2] == 0);
                if (std::memcmp(head + 2, "TRANSFORM", 10) == 0) EXPECT(size == 12 + 48 + 2);
            }
            surfaces += std::strcmp(reinterpret_cast<char *>(head) + 14, "prostate") == 0;
            if (std::strcmp(reinterpret_cast<char *>(head) + 14, "prostate") == 0) answered.insert(head[1]);
        }
        EXPECT(surfaces == 2, "version %d: %d surfaces", version, surfaces);
    }
    EXPECT(answered == (std::set<int>{1, 2}));
    std::vector<unsigned char> body = {0, 12, 0, 10, 0, 0, 0, 8, 0, 0, 0, 1}, content = raw_columns(STYLUS); /* with the metadata "Unit: mm" */
    body.insert(body.end(), content.begin(), content.end());
    for (unsigned char c : {0, 1, 0, 4, 0, 3, 0, 0, 0, 4}) body.push_back(c);
    for (char c : std::string("Unitmmmm")) body.push_back(static_cast<unsigned char>(c));
    Connection tracker(bridge.port());
    tracker.send(raw(2, "TRANSFORM", "StylusToReference", body, body.size()));
    EXPECT(soon([&] { return !server.poses().empty(); }), "%s", bridge.errors_text().c_str());
}

static void test_server_restart(const Mesh &mesh) {
    FakeServer server;
    set_up(server, mesh);
    server.displace = shear;
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(bridge.ready());
    Client client(bridge.port());
    EXPECT(client.has({"prostate"})); /* until a server is heard, the tissue is shown at rest */
    EXPECT(client.text("TrocarStatus").find("\"server\": false") != std::string::npos || client.until([&] { return client.counts["TrocarStatus"] > 0; }));
    server.start();
    EXPECT(client.has({"NeedleToReference"}));
    auto tells = [&](const char *part) { return client.until([&] { return client.text("TrocarStatus").find(part) != std::string::npos; }); };
    EXPECT(tells("\"server\": true") && bridge.said("connected to the server"));
    server.silent = true;
    EXPECT(tells("\"server\": false") && bridge.said("the server is silent"), "%s", bridge.errors_text().c_str());
    server.number = 78;
    server.silent = false;
    EXPECT(tells("\"server\": true") && bridge.said("another server"), "%s", bridge.errors_text().c_str());
    client.counts.clear();
    client.receive_for(1);
    EXPECT(client.counts["NeedleToReference"] >= 25, "%d", client.counts["NeedleToReference"]);
    server.most_nodes = 10; /* not the bridge's mesh */
    EXPECT(soon([&] { return bridge.said("is --scene " + std::string(trocar_scene_path(mesh.scene)) + " its scene"); }));
    EXPECT(bridge.stop(SIGINT) == 0);
}

static void test_faults() {
    Mesh mesh(write_scene());
    test_slow_client(mesh);
    test_garbage(mesh);
    test_versions(mesh);
    test_server_restart(mesh);
    struct { std::vector<std::string> arguments; const char *said; } wrong[] = {
        {{bridge_path}, "--scene is missing"},
        {{bridge_path, "--scene", work + "/none.yaml"}, "none.yaml"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--rate", "100"}), "rate"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--images", "blue"}), "echo, regions or none"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--needle", "99"}), "has needles 0 to 15"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--needle-from", "ANameOfMoreThan20Letters"}), "1 to 20 letters"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--needle-from", "ProbeToReference"}), "cannot drive both"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--bind", "nowhere"}), "--bind nowhere"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--tracker", "nowhere.invalid"}), "--tracker nowhere.invalid"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--tracker", "::1"}), "address in brackets"},
        {bridge_command(trocar_scene_path(mesh.scene), {"--lcm-url", "nothing://"}), "cannot open LCM at nothing://"},
        {bridge_command(write_scene("far.yaml", "[0, -0.3, -0.08]"), {"--pixel", "0.1"}), "--pixel 0.1: an image would have"}, /* 0.3 m deep */
    };
    for (const auto &w : wrong) {
        Program bridge(work, w.arguments);
        EXPECT(bridge.exit_status() == 2 && bridge.said(w.said), "%s", bridge.errors_text().c_str());
    }
    Program first(work, bridge_command(trocar_scene_path(mesh.scene)));
    EXPECT(first.ready());
    std::string port = std::to_string(first.port());
    std::filesystem::create_directory(work + "/second");
    Program second(work + "/second", {bridge_path, "--scene", trocar_scene_path(mesh.scene), "--port", port});
    EXPECT(second.exit_status() == 2 && second.said("port " + port), "%s", second.errors_text().c_str());
}

/* ---- trackers ---- */

static void test_trackers() {
    Mesh mesh(write_scene());
    FakeServer server;
    set_up(server, mesh);
    server.start();
    igtl::ServerSocket::Pointer plus = igtl::ServerSocket::New(); /* a tracker that acts as a server */
    Program bridge(work, bridge_command(trocar_scene_path(mesh.scene), {"--tracker", "127.0.0.1:18945", "--probe-from", "StepperToReference"}));
    EXPECT(bridge.ready());
    EXPECT(soon([&] { return bridge.said("no tracker at 127.0.0.1:18945"); }));

    /* Two poses of a tracker are 50 ms and 10 mm apart. The needle moves from one to the other at constant speed, in small steps. */
    igtl::ClientSocket::Pointer client = igtl::ClientSocket::New();
    EXPECT(client->ConnectToServer("127.0.0.1", bridge.port()) == 0);
    Columns moved = STYLUS;
    moved.numbers[9] += 10; /* 10 mm to the right, which is the mesh's -y direction */
    send_transform(client, "StylusToReference", STYLUS);
    EXPECT(soon([&] { return !server.poses().empty(); }), "%s", bridge.errors_text().c_str());
    wait(0.05);
    send_transform(client, "StylusToReference", STYLUS);
    wait(0.05);
    server.poses();
    send_transform(client, "StylusToReference", moved);
    send_transform(client, "AnotherToReference", {{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}});
    wait(0.3);
    auto poses = server.poses();
    double largest = 0;
    int between = 0;
    EXPECT(poses.size() > 50, "%zu poses in 0.3 s", poses.size());
    for (size_t i = 0; i < poses.size(); i++) {
        const double *p = poses[i].position, *q = poses[i].orientation;
        double along = -(p[1] - 0.02);
        EXPECT(std::fabs(p[0] - 0.01) < 1e-8 && std::fabs(p[2] - 0.03) < 1e-8 && along > -1e-8 && along < 0.01 + 1e-8, "pose at %g %g %g", p[0], p[1], p[2]);
        for (int a = 0; a < 4; a++) EXPECT(std::fabs(std::fabs(q[a]) - 0.5) < 1e-7 && q[a] * q[0] > 0, "orientation %g", q[a]);
        between += along > 1e-6 && along < 0.01 - 1e-6;
        if (i > 0) largest = std::max(largest, std::fabs(p[1] - poses[i - 1].position[1]));
        EXPECT(poses[i].needle == 0);
    }
    EXPECT(between >= 5 && largest < 0.006, "%d poses between, the largest step %g m", between, largest);
    EXPECT(!poses.empty() && std::fabs(poses.back().position[1] - 0.01) < 1e-8);

    /* If poses fail to arrive, the needle stops and is then released. The next pose takes it again. */
    wait(1);
    poses = server.poses();
    EXPECT(poses.size() > 100 && server.releases == 0, "%zu poses", poses.size());
    EXPECT(soon([&] { return server.releases == 1; }, 5) && bridge.said("needle 0 is released"), "%s", bridge.errors_text().c_str());
    server.poses();
    wait(0.2);
    EXPECT(server.poses().empty());
    send_transform(client, "StylusToReference", moved);
    EXPECT(soon([&] { return !server.poses().empty(); }));

    /* A stepper moves the probe. The mesh's x, y and z axes point to the head, from right to left, and from front to back. */
    server.probes();
    send_transform(client, "StepperToReference", {{0, 0, 1, -1, 0, 0, 0, -1, 0, 12, 110, -10}});
    std::vector<trocar_probe_pose_t> probes;
    EXPECT(soon([&] { probes = server.probes(); return !probes.empty(); }));
    if (!probes.empty()) {
        const double wanted[7] = {0, -0.032, -0.08, 1, 0, 0, 0};
        for (int a = 0; a < 3; a++) EXPECT(std::fabs(probes[0].position[a] - wanted[a]) < 1e-8, "the probe: %g", probes[0].position[a]);
        for (int a = 0; a < 4; a++) EXPECT(std::fabs(std::fabs(probes[0].orientation[a]) - wanted[3 + a]) < 1e-7, "the probe: %g", probes[0].orientation[a]);
        EXPECT(probes[0].session != 0);
    }
    client->CloseSocket();

    /* Connects to a tracker that acts as a server. The tracker then disappears and comes back. */
    EXPECT(soon([&] { return server.releases == 2; }, 5));
    EXPECT(plus->CreateServer(18945) == 0);
    for (int i = 0; i < 2; i++) {
        igtl::ClientSocket::Pointer socket = plus->WaitForConnection(5000);
        EXPECT(socket.IsNotNull(), "%s", bridge.errors_text().c_str());
        if (socket.IsNull()) break;
        server.poses();
        send_transform(socket, "StylusToReference", STYLUS);
        EXPECT(soon([&] { return !server.poses().empty(); }), "%s", bridge.errors_text().c_str());
        EXPECT(bridge.said("reading transforms from 127.0.0.1:18945"));
        socket->CloseSocket();
        EXPECT(soon([&] { return bridge.said("127.0.0.1:18945 has disconnected"); }));
    }
    EXPECT(bridge.stop(SIGTERM) == 0);
}

/* ---- a real server ---- */

/* A tracker inserts the needle of figure 8, whose mesh is not in patient coordinates: right, front and head are the mesh's x, y and z axes. */
static void test_server() {
    std::string scene = meshes + "/figure8.yaml";
    std::filesystem::create_directory(work + "/server");
    auto server = std::make_unique<Program>(work + "/server", std::vector<std::string>{server_path, "--scene", scene, "--allow-non-rt"});
    EXPECT(server->ready(), "%s", server->errors_text().c_str());
    Program bridge(work, bridge_command(scene));
    EXPECT(bridge.ready() && bridge.said("has no patient_to_mesh"), "%s", bridge.errors_text().c_str());
    Client client(bridge.port());
    double force = 0, depth = 0;
    auto insert = [&] { /* 35 mm at 20 mm/s, with 30 poses per second */
        for (int i = 0; i < 53; i++) {
            send_transform(client.socket, "StylusToReference", {{1, 0, 0, 0, 1, 0, 0, 0, 1, 5, 3, -205 + 20.0f * static_cast<float>(i) / 30}});
            client.receive_for(1.0 / 30);
            if (client.counts["NeedleForce"]) force = std::max(force, std::fabs(static_cast<double>(client.transform("NeedleForce").numbers[11])));
        }
        client.receive_for(0.2);
        std::string text = client.text("TrocarStatus");
        size_t at = text.find("\"depth_mm\": ");
        depth = at == std::string::npos ? 0 : std::atof(text.c_str() + at + 12);
    };
    insert();
    EXPECT(force > 0.3 && force < 20, "%g N", force);
    EXPECT(depth > 20 && depth < 32, "%g mm", depth); /* about 30 mm, because the tip started 5 mm in front of the skin at z = 0 */
    Columns base = client.transform("NeedleToReference"), tip = client.transform("NeedleTipToReference");
    const float last = -205 + 20.0f * 52 / 30;
    EXPECT(std::fabs(base.numbers[9] - 5) < 1e-3 && std::fabs(base.numbers[10] - 3) < 1e-3 && std::fabs(base.numbers[11] - last) < 0.01, "base at z = %g mm", base.numbers[11]);
    EXPECT(std::fabs(tip.numbers[11] - (last + 200)) < 1 && std::hypot(tip.numbers[9] - 5, tip.numbers[10] - 3) < 10, "tip at z = %g mm", tip.numbers[11]);

    /* The server is killed and started again. Clients stay connected and are informed, and the tracker holds the needle again. */
    server->stop(SIGKILL);
    EXPECT(client.until([&] { return client.text("TrocarStatus").find("\"server\": false") != std::string::npos; }));
    server = std::make_unique<Program>(work + "/server", std::vector<std::string>{server_path, "--scene", scene, "--allow-non-rt"});
    EXPECT(server->ready());
    force = 0;
    insert();
    EXPECT(bridge.said("the server is silent") && bridge.said("another server"), "%s", bridge.errors_text().c_str());
    EXPECT(client.text("TrocarStatus").find("\"server\": true") != std::string::npos);
    /* the force is smaller, because the new server's needle starts inside the tissue, which counts as cut along the needle */
    EXPECT(force > 0.1 && depth > 20, "%g N at %g mm", force, depth);
    EXPECT(bridge.stop(SIGTERM) == 0 && server->stop(SIGTERM) == 0);
}

/* Used by measure.py: acts as a server of the scene MESHES that sends 30 frames per second, each different, until it is stopped. */
static void stream() {
    Mesh mesh(meshes);
    FakeServer server;
    set_up(server, mesh);
    server.displace = [](const Vector &x, double t) { return Vector{0.01 * x[2] * std::sin(2 * t), 0, 0}; };
    server.centreline = {{0.005, 0.003, -0.15}, {0.005, 0.003, -0.05}, {0.005, 0.003, 0.05}};
    server.start();
    std::printf("ready\n");
    std::fflush(stdout);
    for (;;) wait(1);
}

int main(int count, char **arguments) {
    if (count != 5) return 2;
    signal(SIGPIPE, SIG_IGN);
    bridge_path = arguments[1], server_path = arguments[2], meshes = arguments[3];
    char folder[] = "/tmp/test_slicer.XXXXXX";
    if (!mkdtemp(folder)) return 1;
    work = folder;
    std::string chosen = arguments[4];
    if (chosen == "values") test_values(), test_echo();
    else if (chosen == "faults") test_faults();
    else if (chosen == "trackers") test_trackers();
    else if (chosen == "server") test_server();
    else if (chosen == "slow") test_slow();
    else if (chosen == "stream") stream();
    else return 2;
    std::filesystem::remove_all(work);
    if (failures == 0) std::puts("passed");
    return failures == 0 ? 0 : 1;
}
