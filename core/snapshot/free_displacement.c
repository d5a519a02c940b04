#include "snapshot/free_displacement.h"

#include <string.h>

#include "inverse/inverse_attached.h"

enum { MAX_NODES = MAX_WINDOW + 4 * MAX_CONTACTS };

/* Nominal nodes, without duplicates, each with a displacement per set of loads. */
typedef struct {
    int count, nodes[MAX_NODES];
    vec3 displacement[MAX_RELAXATION][MAX_NODES];
} node_field;

static int place_of(const node_field *field, int node) {
    int k = 0;
    while (k < field->count && field->nodes[k] != node) k++;
    return k;
}

static void list_node(node_field *field, int node) {
    int place = place_of(field, node);
    if (place == field->count) field->nodes[field->count++] = node;
}

/* Lists the nodes of the window, and the corners of the elements that contain contact nodes. */
static void list_nodes(const mesh *m, const remesh_request *request, const int window[MAX_WINDOW], node_field *field) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (window[k] >= 0) list_node(field, window[k]);
    for (int i = 0; i < request->wanted.count; i++)
        for (int c = 0; c < 4; c++) list_node(field, m->tets[request->wanted.nodes[request->wanted.order[i]].tet][c]);
}

/* Adds the displacements due to forces (N, one per set) at a point of an element. */
static trocar_status add_forces(inverse *inv, int tet, const double weights[4], int sets, const vec3 *forces, node_field *field, trocar_error *why) {
    double blocks[3 * MAX_NODES][12];
    const int *corners = inverse_tissue(inv)->mesh->tets[tet];
    trocar_status status = inverse_gather(inv, &(inverse_blocks){field->count, field->nodes, 4, corners, blocks[0], 12}, why);
    if (status != TROCAR_OK) return status;
    for (int k = 0; k < field->count; k++)
        for (int c = 0; c < 4; c++) {
            mat3 block = {{{0}}};
            m3_add_block(&block, weights[c], &blocks[3 * k][3 * c], 12);
            for (int s = 0; s < sets; s++) field->displacement[s][k] = v3_add(field->displacement[s][k], m3_apply(&block, forces[s]));
        }
    return TROCAR_OK;
}

trocar_status nodal_displacement_add(inverse *inv, const nodal_forces *loads, int count, const int *nodes, vec3 *displacement, trocar_error *why) {
    enum { SIDE = 32 };
    double blocks[3 * SIDE][3 * SIDE];
    for (int first = 0; first < count; first += SIDE)
        for (int from = 0; from < loads->count; from += SIDE) {
            int rows = count - first < SIDE ? count - first : SIDE, columns = loads->count - from < SIDE ? loads->count - from : SIDE;
            trocar_status status = inverse_gather(inv, &(inverse_blocks){rows, nodes + first, columns, loads->nodes + from, blocks[0], 3 * SIDE}, why);
            if (status != TROCAR_OK) return status;
            for (int i = 0; i < rows; i++)
                for (int j = 0; j < columns; j++) {
                    mat3 block = {{{0}}};
                    m3_add_block(&block, 1.0, &blocks[3 * i][3 * j], 3 * SIDE);
                    displacement[first + i] = v3_add(displacement[first + i], m3_apply(&block, loads->force[from + j]));
                }
        }
    return TROCAR_OK;
}

/* Converts the displacements under one set of loads from nodes to handles (MAX_HANDLES entries). */
static void read_handles(const mesh *m, const remesh_request *request, const int window[MAX_WINDOW], const node_field *field, int set, vec3 *handles) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (window[k] >= 0) handles[MAX_CONTACTS + k] = field->displacement[set][place_of(field, window[k])];
    for (int i = 0; i < request->wanted.count; i++) {
        int slot = request->wanted.order[i];
        const added_node *node = &request->wanted.nodes[slot];
        double weights[4];
        mesh_barycentric(m, node->tet, node->position, weights);
        for (int c = 0; c < 4; c++)
            handles[slot] = v3_axpy(weights[c], field->displacement[set][place_of(field, m->tets[node->tet][c])], handles[slot]);
    }
}

trocar_status free_displacement_find(inverse *inv, const remesh_request *request, const other_loads *others, compliance_snapshot *snapshot, trocar_error *why) {
    const mesh *m = inverse_tissue(inv)->mesh;
    snapshot->loaded = others->attached || others->pressed;
    for (int i = 0; i < others->count; i++) snapshot->loaded = snapshot->loaded || others->of[i]->count > 0;
    memset(snapshot->u_free, 0, sizeof snapshot->u_free);
    if (!snapshot->loaded) return TROCAR_OK;
    node_field field = {.count = 0};
    list_nodes(m, request, snapshot->window, &field);
    for (int n = 0; n < others->count; n++)
        for (int i = 0; i < others->of[n]->count; i++) {
            const tissue_load *load = &others->of[n]->loads[i];
            trocar_status status = add_forces(inv, load->tet, load->weights, 1, &load->force, &field, why);
            if (status != TROCAR_OK) return status;
        }
    if (others->attached) {
        trocar_status status = inverse_attached_displace(others->beneath, others->attached, field.count, field.nodes, field.displacement[0], why);
        if (status != TROCAR_OK) return status;
    }
    if (others->pressed) {
        trocar_status status = nodal_displacement_add(others->beneath, others->pressed, field.count, field.nodes, field.displacement[0], why);
        if (status != TROCAR_OK) return status;
    }
    read_handles(m, request, snapshot->window, &field, 0, snapshot->u_free);
    return TROCAR_OK;
}

trocar_status residual_displacement_find(inverse *inv, const remesh_request *request, const int window[MAX_WINDOW], residual_field *residual,
                                         trocar_error *why) {
    const mesh *m = inverse_tissue(inv)->mesh;
    residual->any = request->residual_loads.count > 0;
    residual->time = request->residual_loads.time;
    if (!residual->any) return TROCAR_OK;
    node_field field = {.count = 0};
    list_nodes(m, request, window, &field);
    for (int i = 0; i < request->residual_loads.count; i++) {
        const residual_load *load = &request->residual_loads.loads[i];
        trocar_status status = add_forces(inv, load->tet, load->weights, MAX_RELAXATION, load->load, &field, why);
        if (status != TROCAR_OK) return status;
    }
    memset(residual->u, 0, sizeof residual->u);
    for (int s = 0; s < MAX_RELAXATION; s++) read_handles(m, request, window, &field, s, residual->u[s]);
    return TROCAR_OK;
}

int loads_most_nodes(const other_loads *others) {
    int most = others->pressed ? others->pressed->count : 0;
    for (int n = 0; n < others->count; n++) most += 4 * others->of[n]->count;
    return most;
}

int loads_on_nodes(const mesh *m, const other_loads *others, int *nodes, vec3 *forces) {
    int count = others->pressed ? others->pressed->count : 0;
    for (int i = 0; i < count; i++) nodes[i] = others->pressed->nodes[i], forces[i] = others->pressed->force[i];
    for (int n = 0; n < others->count; n++)
        for (int i = 0; i < others->of[n]->count; i++) {
            const tissue_load *load = &others->of[n]->loads[i];
            for (int c = 0; c < 4; c++) {
                int k = 0, node = m->tets[load->tet][c];
                while (k < count && nodes[k] != node) k++;
                if (k == count) nodes[count] = node, forces[count++] = v3(0, 0, 0);
                forces[k] = v3_axpy(load->weights[c], load->force, forces[k]);
            }
        }
    return count;
}

void loads_spread(const mesh *m, const tissue_loads *loads, vec3 *nominal) {
    for (int i = 0; i < loads->count; i++)
        for (int c = 0; c < 4; c++) {
            vec3 *corner = &nominal[m->tets[loads->loads[i].tet][c]];
            *corner = v3_axpy(loads->loads[i].weights[c], loads->loads[i].force, *corner);
        }
}
