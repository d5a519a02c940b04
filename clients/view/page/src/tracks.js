// Draws the tracks that needles have cut in the deformed tissue: a line for each track, and a dot at each puncture.
import * as THREE from 'three'
import { interpolate, weightsIn } from './barycentric.js'
import { Filled, show } from './buffers.js'
import { TRACK } from './colours.js'
import { TRACK_NUMBERS } from './decode.js'

function append(filled, place) {
  filled.reserve(3)
  filled.array.set(place, filled.count)
  filled.count += 3
}

export class Tracks {
  constructor({ nodes, tets }) {
    this.nodes = nodes
    this.tets = tets
    this.ends = new Filled() // m, 2 points per line segment, 3 coordinates each
    this.holes = new Filled() // 1 point per puncture
    this.lines = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: TRACK }))
    this.punctures = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color: TRACK, size: 6, sizeAttenuation: false }))
    for (const part of [this.lines, this.punctures]) part.frustumCulled = false
    this.group = new THREE.Group().add(this.lines, this.punctures)
  }

  get empty() { return this.ends.count === 0 && this.holes.count === 0 }

  /** Draws the tracks of a picture's `needles`. `moved` are the displaced nodes. Called only if the picture differs from the one before. */
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

  displaced(place, tet, moved) {
    return 5 * tet + 5 <= this.tets.length && tet >= 0 ? interpolate(this, tet, weightsIn(this, tet, place), moved) : place
  }
}
