/* A program outside of the tree that uses the mechanics: the paper's needle alone, built from the defaults. */
#include <trocar/core/simulation.h>
#include <trocar_needle_wrench_t.h>

int main(void) {
    static simulation_config config;
    static simulation s;
    report why;
    simulation_defaults(&config);
    trocar_status status = simulation_create(&config, &s, &why);   /* without a mesh: refused, in words */
    puts(why.text);
    trocar_needle_wrench_t wrench = {.depth = 1};
    return status == TROCAR_BAD_INPUT && trocar_needle_wrench_t_encoded_size(&wrench) > 100 ? 0 : 1;
}
