// Computes cross-sections of the deformed tetrahedra: filled triangles, and outlines of surfaces.
import { Filled } from './buffers.js'

// For each set of corners below the plane (a bit mask): the edges that the plane cuts, in order around the cross-section. An edge is a pair of corners.
const CASES = Array.from({ length: 16 }, (_, mask) => {
  const below = [0, 1, 2, 3].filter((i) => mask & (1 << i)), above = [0, 1, 2, 3].filter((i) => !(mask & (1 << i)))
  if (below.length === 0 || above.length === 0) return []
  if (below.length === 1) return above.map((b) => [below[0], b])
  if (above.length === 1) return below.map((a) => [a, above[0]])
  return [[below[0], above[0]], [below[0], above[1]], [below[1], above[1]], [below[1], above[0]]]
})

export class Slicer {
  /** `scene`: as decoded. `cut` and `outline` accept any deformation of its nodes. */
  constructor(scene) {
    this.scene = scene
    this.distance = new Float32Array(scene.nodes.length / 3)
    this.place = new Filled()   // 3 coordinates (m) per vertex, in the deformed mesh
    this.nominal = new Filled() // 3 coordinates (m) per vertex, in the undeformed mesh
    this.region = new Filled()  // 1 per vertex
    this.edges = new Filled()   // 3 coordinates (m) per end of a line segment
  }

  measure(nodes, normal, offset) {
    const [a, b, c] = normal
    for (let n = 0, i = 0; n < this.distance.length; n++, i += 3)
      this.distance[n] = (a * nodes[i] + b * nodes[i + 1] + c * nodes[i + 2] - offset) || 1e-12 // a node on the plane counts as above it
  }

  /** Computes the triangles of the cross-section with the plane normal . x = offset, and fills place, nominal and region. Returns the number of vertices. */
  cut(nodes, normal, offset) {
    const { tets, nodes: rest } = this.scene, { distance, place, nominal, region } = this
    this.measure(nodes, normal, offset)
    place.count = nominal.count = region.count = 0
    for (let t = 0; t < tets.length; t += 5) {
      const mask = (distance[tets[t + 1]] < 0 ? 1 : 0) | (distance[tets[t + 2]] < 0 ? 2 : 0)
                 | (distance[tets[t + 3]] < 0 ? 4 : 0) | (distance[tets[t + 4]] < 0 ? 8 : 0)
      const edges = CASES[mask]
      if (edges.length === 0) continue
      place.reserve(18), nominal.reserve(18), region.reserve(6)
      for (let k = 2; k < edges.length; k++)
        for (const edge of [edges[0], edges[k - 1], edges[k]]) {
          const p = tets[t + 1 + edge[0]], q = tets[t + 1 + edge[1]]
          const part = distance[p] / (distance[p] - distance[q])
          for (let a = 0; a < 3; a++) {
            place.array[place.count++] = nodes[3 * p + a] + part * (nodes[3 * q + a] - nodes[3 * p + a])
            nominal.array[nominal.count++] = rest[3 * p + a] + part * (rest[3 * q + a] - rest[3 * p + a])
          }
          region.array[region.count++] = tets[t]
        }
    }
    return region.count
  }

  /** Returns the corners, three node numbers each, of the triangles for which `wanted(inside, outside, bits)` is true. */
  select(wanted) {
    const { triangles } = this.scene, corners = []
    for (let t = 0; t < triangles.length; t += 6)
      if (wanted(triangles[t + 3], triangles[t + 4], triangles[t + 5])) corners.push(triangles[t], triangles[t + 1], triangles[t + 2])
    return new Uint32Array(corners)
  }

  /** Fills `edges` with the lines in which the plane cuts these triangles: see select. */
  outline(nodes, normal, offset, corners) {
    const { distance, edges } = this
    this.measure(nodes, normal, offset)
    edges.count = 0
    for (let t = 0; t < corners.length; t += 3) {
      const below = (distance[corners[t]] < 0) + (distance[corners[t + 1]] < 0) + (distance[corners[t + 2]] < 0)
      if (below === 0 || below === 3) continue
      edges.reserve(6)
      for (let e = 0; e < 3; e++) {
        const p = corners[t + e], q = corners[t + (e + 1) % 3]
        if ((distance[p] < 0) === (distance[q] < 0)) continue
        const part = distance[p] / (distance[p] - distance[q])
        for (let a = 0; a < 3; a++) edges.array[edges.count++] = nodes[3 * p + a] + part * (nodes[3 * q + a] - nodes[3 * p + a])
      }
    }
    return edges
  }
}
