// Points that move with the tissue.
import * as THREE from 'three'
import { interpolate, weightsIn } from '../barycentric.js'

const EDGE = -1e-6 // tolerance for rounding errors in a barycentric weight

/** Returns the tetrahedron that contains a position [x, y, z] when the nodes are at `nodes`, or -1 outside the tissue. Tries `guess` first. */
export function tetAt(scene, nodes, place, guess = -1) {
  const moved = { nodes, tets: scene.tets }, isIn = (tet) => Math.min(...weightsIn(moved, tet, place)) > EDGE
  if (guess >= 0 && isIn(guess)) return guess
  for (let tet = 0; tet < scene.tets.length / 5; tet++) if (isIn(tet)) return tet
  return -1
}

/** Returns the name of a tetrahedron's organ, which is its region or, if that is part of an organ, the organ; '' outside the tissue. */
export const organOf = (scene, tet) => (tet >= 0 ? scene.regions.find(({ group }) => group === scene.tets[5 * tet])?.organ ?? '' : '')

export class MaterialPoint {
  /** `rest`: position in the undeformed tissue (m). A point outside the tissue does not move. */
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

  /** Returns the point's position when the nodes are at `nodes`. */
  at(nodes) {
    return this.weights ? new THREE.Vector3(...interpolate(this.scene, this.tet, this.weights, nodes)) : this.rest.clone()
  }
}
