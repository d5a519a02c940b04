// The template: names and positions of its holes. A name has a letter for the column, from A, and a number for the row, from 1 in steps of 0.5.
import * as THREE from 'three'

export function columnName(column) {
  return column < 26 ? String.fromCharCode(65 + column) : String.fromCharCode(64 + Math.floor(column / 26), 65 + column % 26)
}

export const rowName = (row) => `${1 + (row >> 1)}${row % 2 ? '.5' : ''}`

export class Template {
  /** `index`: of the guide in the scene; `guide`: the guide as decoded. */
  constructor(guide, index) {
    Object.assign(this, { guide, index, columns: guide.columns, rows: guide.rows })
    for (const [name, vector] of [['origin', guide.origin], ['normal', guide.normal], ['along', guide.alongColumns], ['up', guide.alongRows]])
      this[name] = new THREE.Vector3(...vector)
  }

  /** Returns the hole's index, as in messages. */
  number({ column, row }) { return column + this.columns * row }

  name({ column, row }) { return columnName(column) + rowName(row) }

  /** Returns the hole with this name, such as "c3.5" or "C 3,5", or null if there is none. */
  find(text) {
    const match = /^([A-Z]{1,2})([1-9]\d?)([.]([05]))?$/.exec(text.toUpperCase().replace(/\s/g, '').replace(',', '.'))
    if (!match) return null
    const column = [...match[1]].reduce((sum, letter) => 26 * sum + letter.charCodeAt(0) - 64, 0) - 1, row = 2 * (Number(match[2]) - 1) + (match[4] === '5' ? 1 : 0)
    return column < this.columns && row < this.rows ? { column, row } : null
  }

  /** Returns the names of the last column and row. */
  get last() { return { column: columnName(this.columns - 1), row: rowName(this.rows - 1) } }

  /** Returns the centre of a hole in the face at which needles enter. */
  place({ column, row }) {
    const { spacing } = this.guide
    return this.origin.clone().addScaledVector(this.along, (column - (this.columns - 1) / 2) * spacing).addScaledVector(this.up, (row - (this.rows - 1) / 2) * spacing)
  }

  /** Returns the corners of a rectangle that extends a little beyond the outer holes. */
  corners() {
    const { spacing } = this.guide
    return [[0, 0, -1], [this.columns - 1, this.rows - 1, 1]].map(([column, row, side]) => this.place({ column, row }).addScaledVector(this.along, 1.6 * side * spacing).addScaledVector(this.up, 2.6 * side * spacing))
  }

  /** Returns the hole in line with a point, and the point's distance (m) from the hole's axis; null if the point is beside the template. */
  nearest(point) {
    const { spacing } = this.guide, from = point.clone().sub(this.origin)
    const column = Math.round(from.dot(this.along) / spacing + (this.columns - 1) / 2), row = Math.round(from.dot(this.up) / spacing + (this.rows - 1) / 2)
    if (!(column >= 0 && row >= 0 && column < this.columns && row < this.rows)) return null
    return { column, row, distance: this.aside(point, { column, row }).length() }
  }

  /** Returns the vector from the hole's axis to the point, perpendicular to the axis. */
  aside(point, hole) {
    const from = point.clone().sub(this.place(hole))
    return from.addScaledVector(this.normal, -from.dot(this.normal))
  }

  /** Returns the point on the hole's axis `depth` (m) beyond the face at which needles enter. */
  onAxis(hole, depth) { return this.place(hole).addScaledVector(this.normal, depth) }

  depthOf(point) { return point.clone().sub(this.origin).dot(this.normal) }

  /** Returns the hole that a needle is in, given the points of its shape; null if it has not entered the plate. */
  holeOf(line) {
    const points = line?.places ?? [], at = points.findIndex((point) => this.depthOf(point) > 0)
    if (at < 1) return null
    const found = this.nearest(points[at])
    return found && found.distance < this.guide.holeDiameter ? found : null
  }
}
