// Draws isodose lines on a computed ultrasound image, by marching squares over the dose on a grid in the image's plane.
import { ISODOSE } from '../colours.js'

const STEP = 1e-3 // m between samples, as in the dose grid
const WIDTH = 1.5 // px

export class Isolines {
  constructor() { this.samples = new Float32Array(0) }

  /** `slice`: the Echo whose dose is drawn. The image begins at `from` and extends by `size`, both in m across and up in the slice. */
  draw(ink, slice, from, size) {
    const { doses } = slice
    if (!doses.doseTop.value) return
    const columns = Math.ceil(size[0] / STEP) + 1, rows = Math.ceil(size[1] / STEP) + 1
    this.sample(slice, from, columns, rows)
    for (const { level, colour } of ISODOSE) {
      ink.strokeStyle = colour
      ink.lineWidth = WIDTH * slice.unit
      ink.beginPath()
      this.trace(level, columns, rows, (x, y, move) => ink[move ? 'moveTo' : 'lineTo'](...slice.toPixel(from[0] + x * STEP, from[1] + y * STEP)))
      ink.stroke()
    }
  }

  /** Computes the dose at the grid points, as multiples of the prescription. */
  sample(slice, from, columns, rows) {
    const { dose, doseOrigin, doseSize, doseTop } = slice.doses, { data, width: depth, height, depth: width } = dose.value.image, counts = [width, height, depth]
    const corner = slice.unproject(...from), { across, up } = slice.frame, origin = doseOrigin.value.toArray(), spacing = doseSize.value.toArray().map((length, a) => length / counts[a])
    if (this.samples.length < columns * rows) this.samples = new Float32Array(columns * rows)
    for (let row = 0; row < rows; row++)
      for (let column = 0; column < columns; column++) {
        let at = 0, sum = 0
        const cell = [0, 0, 0], part = [0, 0, 0]
        for (let a = 0; a < 3; a++) { // a voxel's centre is half a voxel from its corner
          const place = (corner[a] + STEP * (column * across[a] + row * up[a]) - origin[a]) / spacing[a] - 0.5
          cell[a] = Math.floor(place)
          part[a] = place - cell[a]
          if (cell[a] < 0 || cell[a] + 1 >= counts[a]) at = -1
        }
        for (let k = 0; k < 8 && at >= 0; k++) {
          const [dx, dy, dz] = [k & 1, k >> 1 & 1, k >> 2], weight = (dx ? part[0] : 1 - part[0]) * (dy ? part[1] : 1 - part[1]) * (dz ? part[2] : 1 - part[2])
          sum += weight * data[((cell[0] + dx) * height + cell[1] + dy) * depth + cell[2] + dz]
        }
        this.samples[row * columns + column] = doseTop.value * sum / 255
      }
  }

  /** Calls `point(x, y, begins)` for both ends of each piece of the line on which the samples equal `level`. x and y count samples. */
  trace(level, columns, rows, point) {
    const { samples } = this
    for (let y = 0; y + 1 < rows; y++)
      for (let x = 0; x + 1 < columns; x++) {
        const corners = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]], values = corners.map(([i, j]) => samples[j * columns + i] - level)
        const ends = []
        for (let e = 0; e < 4; e++) {
          const a = values[e], b = values[(e + 1) % 4]
          if ((a < 0) === (b < 0)) continue
          const part = a / (a - b), [from, to] = [corners[e], corners[(e + 1) % 4]]
          ends.push([from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])])
        }
        for (let e = 0; e < ends.length; e++) point(...ends[e], e % 2 === 0)
      }
  }
}
