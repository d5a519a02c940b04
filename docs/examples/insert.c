/* Pushes a needle 50 mm into a scene at 50 mm/s and prints the force on the hand every 5 mm.
   cc insert.c $(pkg-config --cflags --libs trocar) -o insert && ./insert /usr/share/trocar/scenes/figure8.yaml */
#include <stdio.h>
#include <stdlib.h>
#include <trocar.h>

static trocar_error why;

static void check(trocar_status status) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "insert: %s\n", why.text);
    exit(status == TROCAR_BAD_INPUT ? 2 : 1);
}

int main(int count, char **arguments) {
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    check(trocar_scene_load(count > 1 ? arguments[1] : "scene.yaml", &scene, &why));
    check(trocar_model_create(scene, NULL, &model, &why));
    check(trocar_sim_create(model, &sim, &why));
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}}; /* tip 1 mm in front of the skin */
    check(trocar_sim_reset(sim, 0, &base, &why));
    for (int tick = 1; tick <= 1000; tick++) {
        trocar_output out;
        base.position[2] = -0.201 + tick * 50e-6;
        check(trocar_sim_step(sim, 0, &base, 0.001, &out, &why));
        if (tick % 100 == 0) printf("%.4f %.17g %.17g %.17g\n", tick * 50e-6, out.force[0], out.force[1], out.force[2]);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}
