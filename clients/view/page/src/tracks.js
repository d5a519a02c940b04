// Tracks that the needles have cut, in the deformed tissue: a line each, and a dot at each puncture.
import * as THREE from 'three'
import { Filled, show } from './buffers.js'
import { TRACK } from './colours.js'
import { TRACK_NUMBERS } from './decode.js'

const a = new THREE.Vector3(), b = new THREE.Vector3(), c = new THREE.Vector3(), normal = new THREE.Vector3(), point = new THREE.Vector3() // scratch

function append(filled, place) {
  filled.reserve(3)
  filled.array.set(place, filled.count)
  filled.count += 3
}

export class Tracks {
  constructor({ nodes, tets }) {
    this.nodes = nodes
    this.tets = tets
    this.ends = new Filled() // 2 for each line's segment, 3 numbers each, m
    this.holes = new Filled() // 1 for each puncture
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: TRACK }))
    this.punctures = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: TRACK, size: 6, sizeAttenuation: false }))
    for (const part of [this.lines, this.punctures]) part.frustumCulled = false
    this.group = new THREE.Group().add(this.lines, this.punctures)
  }

  get empty() { return this.ends.count === 0 && this.holes.count === 0 }

  /** `needles` of a picture; `moved`: the displaced nodes. Called only for pictures that differ from the one before. */
  show(needles, moved) {
    const { ends, holes } = this
    ends.count = holes.count = 0
    for (const { tracks } of needles.filter((needle) => needle?.tracks)) {
      let before
      for (let i = 0; i < tracks.places.length; i += TRACK_NUMBERS) {
        const [tet, track, membrane] = tracks.kinds.subarray(i + 3, i + 6), place = this.displaced(tracks.places.subarray(i, i + 3), tet, moved)
        if (before?.track === track) for (const end of [before.place, place]) append(ends, end)
        if (membrane >= 0) append(holes, place)
        before = { place, track }
      }
    }
    show(this.lines.geometry, 'position', ends, 3)
    show(this.punctures.geometry, 'position', holes, 3)
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
