// Points of the tissue, which move with it.
import * as THREE from 'three'
import { interpolate, weightsIn } from '../barycentric.js'

export class MaterialPoint {
  /** `rest`: in the tissue at rest, m. A point outside of the tissue does not move. */
  constructor(scene, rest) {
    this.scene = scene
    this.rest = rest
    const place = rest.toArray()
    let best = -1e-6
    for (let tet = 0; tet < scene.tets.length / 5; tet++) {
      const weights = weightsIn(scene, tet, place), least = Math.min(...weights)
      if (least > best) Object.assign(this, { tet, weights }), best = least
      if (least > 1e-6) break
    }
  }

  /** Where it is when the nodes are here. */
  at(nodes) {
    return this.weights ? new THREE.Vector3(...interpolate(this.scene, this.tet, this.weights, nodes)) : this.rest.clone()
  }
}
