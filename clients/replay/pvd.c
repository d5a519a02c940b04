#include "replay/pvd.h"

#include <string.h>

#include "replay/vtu.h"

trocar_status pvd_open(pvd_series *p, const char *prefix, trocar_error *why) {
    char path[1024];
    *p = (pvd_series){.prefix = prefix};
    if (snprintf(path, sizeof path, "%s.pvd", prefix) >= (int)sizeof path)
        return fail(why, TROCAR_BAD_INPUT, "%s: path too long", prefix);
    trocar_status status = output_open(&p->list, path, why);
    if (status != TROCAR_OK) return status;
    fprintf(p->list.file, "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n<Collection>\n");
    return TROCAR_OK;
}

/* Adds a state to the list. File names in it are relative to its folder. */
static void list_state(pvd_series *p, bool probe, bool membranes, double time) {
    static const char *const parts[] = {"tissue", "needle", "probe", "membranes"};
    const bool written[] = {true, true, probe, membranes};
    const char *slash = strrchr(p->prefix, '/'), *name = slash ? slash + 1 : p->prefix;
    for (int i = 0; i < 4; i++)
        if (written[i]) fprintf(p->list.file, "<DataSet timestep=\"%.6f\" part=\"%d\" file=\"%s-%04d-%s.vtu\"/>\n", time, i, name, p->count, parts[i]);
}

bool pvd_is_due(const pvd_series *p, double time) { return p->list.file && time >= (double)p->count / PVD_HZ - 1e-9; }

trocar_status pvd_take(pvd_series *p, const trocar_model *model, trocar_picture *picture, const trocar_output *output,
                       const patient_frame *patient, double time, trocar_error *why) {
    char prefix[1024];
    if (snprintf(prefix, sizeof prefix, "%s-%04d", p->prefix, p->count) >= (int)sizeof prefix)
        return fail(why, TROCAR_BAD_INPUT, "%s: path too long", p->prefix);
    trocar_status status = vtu_write_tissue(model, picture, patient, prefix, why);
    if (status == TROCAR_OK) status = vtu_write_needle(model, picture, output, patient, prefix, why);
    if (status == TROCAR_OK) status = vtu_write_probe(model, picture, patient, prefix, why);
    trocar_probe_shape ignored;
    if (status == TROCAR_OK) list_state(p, trocar_model_probe(model, &ignored), vtu_has_membranes(model), time);
    p->count++;
    return status;
}

trocar_status pvd_close(pvd_series *p, trocar_error *why) {
    if (p->list.file) fprintf(p->list.file, "</Collection>\n</VTKFile>\n");
    return output_commit(&p->list, why);
}

void pvd_abandon(pvd_series *p) { output_abandon(&p->list); }
