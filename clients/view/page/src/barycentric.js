// Points in tetrahedra, which move with the tetrahedron's corners.
import * as THREE from 'three'

const a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3(), normal = new THREE.Vector3(), point = new THREE.Vector3()

/** Returns the barycentric weights of a position [x, y, z] in a tetrahedron. A corner's weight is the position's distance from the opposite face
 * divided by the corner's own. */
export function weightsIn({ nodes, tets }, tet, place) {
  const corners = tets.subarray(5 * tet + 1, 5 * tet + 5)
  return [0, 1, 2, 3].map((k) => {
    const [p, q, r] = [1, 2, 3].map((step) => 3 * corners[(k + step) % 4])
    a.fromArray(nodes, p)
    normal.crossVectors(b.fromArray(nodes, q).sub(a), c.fromArray(nodes, r).sub(a))
    return point.fromArray(place).sub(a).dot(normal) / b.fromArray(nodes, 3 * corners[k]).sub(a).dot(normal)
  })
}

/** Returns the position [x, y, z] of the point with these weights when the nodes are at `moved`. */
export function interpolate({ tets }, tet, weights, moved) {
  const result = [0, 0, 0]
  weights.forEach((weight, k) => { for (let axis = 0; axis < 3; axis++) result[axis] += weight * moved[3 * tets[5 * tet + 1 + k] + axis] })
  return result
}
