// Points of the tissue, which move with it.
import * as THREE from 'three'

const corners = [0, 1, 2, 3].map(() => new THREE.Vector3()), normal = new THREE.Vector3(), edge = new THREE.Vector3(), other = new THREE.Vector3()

/** Barycentric weights of a point in a tetrahedron. */
function weightsIn(scene, tet, point) {
  for (let k = 0; k < 4; k++) corners[k].fromArray(scene.nodes, 3 * scene.tets[5 * tet + 1 + k])
  return [0, 1, 2, 3].map((k) => {
    const [a, b, c] = [1, 2, 3].map((step) => corners[(k + step) % 4])
    normal.crossVectors(edge.subVectors(b, a), other.subVectors(c, a))
    return edge.subVectors(point, a).dot(normal) / other.subVectors(corners[k], a).dot(normal)
  })
}

export class MaterialPoint {
  /** `rest`: in the tissue at rest, m. A point outside of the tissue does not move. */
  constructor(scene, rest) {
    this.scene = scene
    this.rest = rest
    let best = -1e-6
    for (let tet = 0; tet < scene.tets.length / 5; tet++) {
      const weights = weightsIn(scene, tet, rest), least = Math.min(...weights)
      if (least > best) Object.assign(this, { tet, weights }), best = least
      if (least > 1e-6) break
    }
  }

  /** Where it is when the nodes are here. */
  at(nodes) {
    if (!this.weights) return this.rest.clone()
    const place = new THREE.Vector3()
    this.weights.forEach((weight, k) => place.addScaledVector(edge.fromArray(nodes, 3 * this.scene.tets[5 * this.tet + 1 + k]), weight))
    return place
  }
}
