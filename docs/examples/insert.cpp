// Pushes a needle 50 mm into a scene at 50 mm/s and prints the force on the hand every 5 mm.
// Build and run: c++ insert.cpp $(pkg-config --cflags --libs trocar) -o insert && ./insert /usr/share/trocar/scenes/figure8.yaml
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <trocar.h>

static trocar_error why;

static void check(trocar_status status) {
    if (status != TROCAR_OK) throw std::runtime_error(why.text);
}

template <class T> using handle = std::unique_ptr<T, void (*)(T *)>;

int main(int count, char **arguments) try {
    trocar_scene *s;
    trocar_model *m;
    trocar_sim *r;
    check(trocar_scene_load(count > 1 ? arguments[1] : "scene.yaml", &s, &why));
    handle<trocar_scene> scene(s, trocar_scene_free);
    check(trocar_model_create(scene.get(), nullptr, &m, &why));
    handle<trocar_model> model(m, trocar_model_free);
    check(trocar_sim_create(model.get(), &r, &why));
    handle<trocar_sim> sim(r, trocar_sim_free);
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}}; // tip 1 mm in front of the skin
    check(trocar_sim_reset(sim.get(), 0, &base, &why));
    for (int tick = 1; tick <= 1000; tick++) {
        trocar_output out;
        base.position[2] = -0.201 + tick * 50e-6;
        check(trocar_sim_step(sim.get(), 0, &base, 0.001, &out, &why));
        if (tick % 100 == 0) std::printf("%.4f %.17g %.17g %.17g\n", tick * 50e-6, out.force[0], out.force[1], out.force[2]);
    }
} catch (const std::exception &error) {
    std::fprintf(stderr, "insert: %s\n", error.what());
    return 2;
}
