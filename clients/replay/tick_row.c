#include "replay/tick_row.h"

#include "shared/json.h"

void tick_row_csv_head(FILE *out, const char *unit, bool has_probe) {
    fprintf(out, "t [s],fx [N],fy [N],fz [N],tx [N m],ty [N m],tz [N m],depth [m],contacts,events,needle,tip_lead [rad],"
            "base_x [%s],base_y [%s],base_z [%s],tip_x [%s],tip_y [%s],tip_z [%s]", unit, unit, unit, unit, unit, unit);
    if (has_probe)
        fprintf(out, ",probe_fx [N],probe_fy [N],probe_fz [N],probe_tx [N m],probe_ty [N m],probe_tz [N m],probe_contacts,"
                "probe_x [%s],probe_y [%s],probe_z [%s]", unit, unit, unit);
    fputc('\n', out);
}

void tick_row_csv(const tick_row *r, FILE *out) {
    vec3 f = r->force, t = r->torque;
    fprintf(out, "%.6f,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%d,%s,%d,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", r->time, f.x, f.y, f.z, t.x,
            t.y, t.z, r->depth, r->contacts, r->events, r->needle, r->tip_lead, r->base.x, r->base.y, r->base.z, r->tip.x, r->tip.y, r->tip.z);
    if (r->has_probe) {
        f = r->probe_force, t = r->probe_torque;
        fprintf(out, ",%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%d,", f.x, f.y, f.z, t.x, t.y, t.z, r->probe_contacts);
        if (r->probe_placed) fprintf(out, "%.17g,%.17g,%.17g", r->probe_base.x, r->probe_base.y, r->probe_base.z);
        else fprintf(out, ",,"); /* a probe that has not been placed has no position */
    }
    fputc('\n', out);
}

/* Writes a position under a name that ends with its unit, such as "base_m". */
static void json_position(json *j, const char *name, const tick_row *r, vec3 position) {
    char full[32];
    snprintf(full, sizeof full, "%s_%s", name, r->unit);
    json_xyz(j, full, position);
}

void tick_row_json(const tick_row *r, FILE *out) {
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_time_stamp(&j, r->time);
    json_integer(&j, "needle", r->needle);
    json_xyz(&j, "force_N", r->force);
    json_xyz(&j, "torque_Nm", r->torque);
    json_exact(&j, "depth_m", r->depth);
    json_integer(&j, "contacts", r->contacts);
    json_text(&j, "events", r->events);
    json_exact(&j, "tip_lead_rad", r->tip_lead);
    json_position(&j, "base", r, r->base);
    json_position(&j, "tip", r, r->tip);
    if (r->has_probe) {
        json_open(&j, "probe", '{');
        json_xyz(&j, "force_N", r->probe_force);
        json_xyz(&j, "torque_Nm", r->probe_torque);
        json_integer(&j, "contacts", r->probe_contacts);
        if (r->probe_placed) json_position(&j, "base", r, r->probe_base);
        json_close(&j, '}');
    }
    json_close(&j, '}');
    fputc('\n', out);
}
