// Tracks that the needles have cut, in the deformed tissue: a line each, and a dot at each puncture.
import * as THREE from 'three'
import { TRACK } from './colours.js'
import { TRACK_NUMBERS } from './decode.js'

const a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3(), normal = new THREE.Vector3(), point = new THREE.Vector3() // scratch

export class Tracks {
  constructor({ nodes, tets }) {
    this.nodes = nodes
    this.tets = tets
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: TRACK }))
    this.punctures = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: TRACK, size: 6, sizeAttenuation: false }))
    for (const part of [this.lines, this.punctures]) part.frustumCulled = false
    this.group = new THREE.Group().add(this.lines, this.punctures)
  }

  /** `needles` of a picture; `moved`: the displaced nodes. */
  show(needles, moved) {
    const lines = [], punctures = []
    for (const { tracks } of needles.filter((needle) => needle?.tracks)) {
      let before
      for (let i = 0; i < tracks.places.length; i += TRACK_NUMBERS) {
        const [tet, track, membrane] = tracks.kinds.subarray(i + 3, i + 6), place = this.displaced(tracks.places.subarray(i, i + 3), tet, moved)
        if (before?.track === track) lines.push(...before.place, ...place)
        if (membrane >= 0) punctures.push(...place)
        before = { place, track }
      }
    }
    this.lines.geometry.setAttribute('position', new THREE.Float32BufferAttribute(lines, 3))
    this.punctures.geometry.setAttribute('position', new THREE.Float32BufferAttribute(punctures, 3))
  }

  /** Interpolates in a tetrahedron: the weight of a corner is the point's distance from the face opposite it over the corner's. */
  displaced(place, tet, moved) {
    const corners = this.tets.subarray(5 * tet + 1, 5 * tet + 5), result = [0, 0, 0]
    if (corners.length < 4) return place
    for (let k = 0; k < 4; k++) {
      const [p, q, r] = [1, 2, 3].map((step) => 3 * corners[(k + step) % 4])
      a.fromArray(this.nodes, p)
      normal.crossVectors(b.fromArray(this.nodes, q).sub(a), c.fromArray(this.nodes, r).sub(a))
      const weight = point.fromArray(place).sub(a).dot(normal) / b.fromArray(this.nodes, 3 * corners[k]).sub(a).dot(normal)
      for (let axis = 0; axis < 3; axis++) result[axis] += weight * moved[3 * corners[k] + axis]
    }
    return result
  }
}
