"""Follows a curved path with the tip of a needle by model predictive control: the base moves sideways and tilts while it pushes the needle in.

Every 10 ms, the controller linearises the needle with Sim.differentiate, predicts the tip over the next intervals, and chooses the motion of the base that
minimises the distance to the path. The path ends at a material point of the tissue, which the needle displaces. Writes a table (CSV) if a file is named.

python3 follow.py [meshes/figure8.yaml [out/follow.csv]]
"""
import sys

import numpy as np
import trocar

DT, TICKS = 1e-3, 10            # s, ticks per control interval
SPEED, DEPTH = 20e-3, 70e-3     # m/s, and m from the skin to the target along z
BEND = 4e-3                     # m, sideways distance of the target from the line of the straight needle
HORIZON = 40                    # intervals
COST = np.array([0.1, 0.1, 0.02, 0.02])  # m per m, and m per rad: how much error a motion of the base is worth, per interval
LIMIT = np.array([0.15e-3, 0.15e-3, 1.5e-3, 1.5e-3])  # m and rad per interval: sideways motion, and tilt about x and y


def path(z, target, start):
    """Position of the path (x, y) at z: a cubic from the needle's axis at the skin, parallel to it, to the target."""
    s = np.clip(np.asarray(z) / target[2], 0.0, 1.0)[..., None]
    return start + (target[:2] - start) * s**2 * (1.5 - 0.5 * s)


def tilted(q, rotation):
    """Turns the quaternion (w, x, y, z) about the world's x and y axes (rad)."""
    x, y = 0.5 * rotation
    w0, x0, y0, z0 = q
    turned = np.array([w0 - x * x0 - y * y0, x0 + x * w0 + y * z0, y0 + y * w0 - x * z0, z0 + x * y0 - y * x0])
    return turned / np.linalg.norm(turned)


def plan(tip, direction, derivatives, target, start):
    """Returns the next motion of the base (x, y, tilts): the first of those that minimise the squared distances to the path over the horizon.

    The tip moves sideways with the base, and then cuts along its direction, which also follows the base. The derivatives stay as they are now.
    """
    moves = [0, 1, 3, 4]
    position, turn, drift = derivatives.tip[:2, moves], derivatives.direction[:2, moves], derivatives.targets[0][:2, moves]
    step = SPEED * TICKS * DT
    n, m = HORIZON, len(moves)
    rows, sides = np.zeros((n, 2, n, m)), np.zeros((n, 2))
    for k in range(n):
        z = tip[2] + (k + 1) * step
        sides[k] = path(z, target, start) - tip[:2] - (k + 1) * step * direction[:2] / direction[2]
        share = min(max(z / target[2], 0.0), 1.0)**2  # the path's end moves with the tissue, and the path with it
        for j in range(k + 1):
            rows[k, :, j] = position + (k - j) * step * turn - share * drift
    system = np.vstack([rows.reshape(2 * n, n * m), np.diag(np.tile(COST, n))])
    best = np.linalg.lstsq(system, np.concatenate([sides.ravel(), np.zeros(n * m)]), rcond=None)[0]
    return np.clip(best[:m], -LIMIT, LIMIT)


def insert(model, controlled, table=None):
    """Pushes the needle in up to the depth of the target. Returns the distances (m) of the tip to the path at each interval, and to the target at the end."""
    sim = trocar.Sim(model)
    entry = np.array([5e-3, 3e-3, 0.0])
    target = entry + [BEND, 0.5 * BEND, DEPTH]
    base = np.concatenate([entry - [0, 0, model.needle_length + 1e-3], [1, 0, 0, 0]])
    sim.reset(base)
    seed, errors = material_point(model, target), []
    while True:
        motion = np.zeros(4)
        base[2] += SPEED * DT
        _, derivatives = sim.differentiate(base, DT, [target])
        joints = sim.centreline()
        tip, direction = joints[-1], joints[-1] - joints[-2]
        now = target + seed[1] @ sim.displacements()[seed[0]]
        if tip[2] >= now[2]:
            return np.array(errors), np.linalg.norm(tip - now)
        errors.append(np.linalg.norm(tip[:2] - path(tip[2], now, entry[:2])))
        if table is not None:
            table.append([*tip, *path(tip[2], now, entry[:2]), *base[:3]])
        if controlled:
            motion = plan(tip, direction / np.linalg.norm(direction), derivatives, now, entry[:2])
        for _ in range(TICKS - 1):
            base[:2] += motion[:2] / (TICKS - 1)
            base[2] += SPEED * DT
            base[3:] = tilted(base[3:], motion[2:] / (TICKS - 1))
            sim.step(base, DT)


def material_point(model, x):
    """Returns the nodes of the tetrahedron that contains x (m), and the barycentric weights of x in it."""
    corners = model.nodes[model.tets]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    rest = np.linalg.solve(edges, (x - corners[:, 0])[..., None])[..., 0]
    weights = np.concatenate([1.0 - rest.sum(1, keepdims=True), rest], axis=1)
    tet = np.argmax(weights.min(1))
    return model.tets[tet], weights[tet]


def main():
    scene = trocar.Scene.load(sys.argv[1] if len(sys.argv) > 1 else "meshes/figure8.yaml")
    model = trocar.Model(scene)
    table = []
    for name, controlled in (("straight", False), ("controlled", True)):
        errors, miss = insert(model, controlled, table if controlled else None)
        print("%-10s  misses the target by %.2f mm; distance from the path: mean %.2f mm, most %.2f mm" %
              (name, 1e3 * miss, 1e3 * errors.mean(), 1e3 * errors.max()))
    if len(sys.argv) > 2:
        np.savetxt(sys.argv[2], table, delimiter=",", header="tip_x,tip_y,tip_z,path_x,path_y,base_x,base_y,base_z", comments="")


if __name__ == "__main__":
    main()
