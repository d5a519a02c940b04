// Points of the tissue, which move with it.
import * as THREE from 'three'
import { interpolate, weightsIn } from '../barycentric.js'

const EDGE = -1e-6 // of a weight, rounding

/** The tetrahedron that a place [x, y, z] is in when the nodes are at `nodes`, -1: outside of the tissue. `guess`: one that it may still be in. */
export function tetAt(scene, nodes, place, guess = -1) {
  const moved = { nodes, tets: scene.tets }, isIn = (tet) => Math.min(...weightsIn(moved, tet, place)) > EDGE
  if (guess >= 0 && isIn(guess)) return guess
  for (let tet = 0; tet < scene.tets.length / 5; tet++) if (isIn(tet)) return tet
  return -1
}

/** The name of a tetrahedron's region, '' for none. */
export const regionOf = (scene, tet) => (tet >= 0 ? scene.regions.find(({ group }) => group === scene.tets[5 * tet])?.name ?? '' : '')

export class MaterialPoint {
  /** `rest`: in the tissue at rest, m. A point outside of the tissue does not move. */
  constructor(scene, rest) {
    this.scene = scene
    this.rest = rest
    const place = rest.toArray()
    let best = EDGE
    for (let tet = 0; tet < scene.tets.length / 5; tet++) {
      const weights = weightsIn(scene, tet, place), least = Math.min(...weights)
      if (least > best) Object.assign(this, { tet, weights }), best = least
      if (least > 1e-6) break
    }
  }

  /** Its place when the nodes are at `nodes`. */
  at(nodes) {
    return this.weights ? new THREE.Vector3(...interpolate(this.scene, this.tet, this.weights, nodes)) : this.rest.clone()
  }
}
