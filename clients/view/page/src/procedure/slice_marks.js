// Draws marks on the slices: the template's holes, the patient's sides, needles, seeds, the plan and the target.
import * as THREE from 'three'
import { BEVEL, CHOSEN, hubColour, PLANNED, SEED, TARGET } from '../colours.js'
import { columnName } from './template.js'
import { t } from '../words/words.js'

const NEAR = { x: 0.0025, z: 0.003 } // m; a seed closer to the slice than this is drawn as lying in it
const GRID = '#9fd8ff', HALO = 'rgba(4, 8, 12, 0.85)'
const LETTERS = [['L', 'R'], ['P', 'A'], ['S', 'I']]
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] }

/** Returns the side of the patient to which an axis of the mesh points. If the scene does not say, assumes that +x, +y and +z are right, front and head. */
function sideOf(scene, axis, sign) {
  const matrix = scene.patientToMesh ?? [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0]
  const patient = [0, 1, 2].map((column) => sign * [0, 1, 2].reduce((sum, row) => sum + matrix[4 * row + column] * AXES[axis][row], 0))
  const most = patient.reduce((best, value, i) => (Math.abs(value) > Math.abs(patient[best]) ? i : best), 0)
  return LETTERS[most][patient[most] < 0 ? 1 : 0]
}

/** Draws text with a dark edge, so that it is readable on any tissue. */
function label(ink, text, x, y, colour) {
  ink.lineWidth = 3 * ink.unit
  ink.strokeStyle = HALO
  ink.lineJoin = 'round'
  ink.strokeText(text, x, y)
  ink.fillStyle = colour
  ink.fillText(text, x, y)
}

function ring(ink, [x, y], radius, colour, width = 1.5, fill = false) {
  ink.beginPath()
  ink.arc(x, y, radius * ink.unit, 0, 2 * Math.PI)
  ink.lineWidth = width * ink.unit
  ink.strokeStyle = ink.fillStyle = colour
  if (fill) ink.fill()
  else ink.stroke()
}

export class SliceMarks {
  /** `model`: the procedure, whose scene, template, hole, target and needles are drawn. */
  constructor(model, slice) {
    this.model = model
    this.slice = slice
    slice.overlays.push((echo, ink) => {
      ink.unit = echo.unit
      const frame = echo.frame
      this.pixel = (point) => { const { x, y } = echo.project(point, frame); return echo.toPixel(x, y) }
      this.draw(echo, ink)
    })
  }

  get isAxial() { return this.slice.plane.normal === 'z' }
  distance(point) { return Math.abs(this.slice.project(point).off) }
  isNear(point) { return this.distance(point) < NEAR[this.slice.plane.normal] }

  draw(echo, ink) {
    const { model } = this
    if (!model.active) return model.plannedNow.forEach((point) => this.drawPlanned(ink, point))
    ink.textAlign = 'center'
    ink.textBaseline = 'middle'
    this.drawSides(echo, ink)
    if (this.isAxial) this.drawGrid(ink)
    else this.drawAxis(ink)
    for (const point of model.plannedNow) this.drawPlanned(ink, point)
    for (const seed of echo.marked ? model.seedsNow : []) this.drawSeed(ink, seed)
    if (echo.marked && !this.isAxial) this.drawNeedles(ink)
    else if (echo.marked) this.drawBevels(ink, echo)
    if (model.target) this.drawTarget(ink, model.targetNow)
    ink.textBaseline = 'alphabetic'
  }

  drawSides(echo, ink) {
    const { width, height } = echo.marks, { across } = echo.plane, unit = ink.unit
    ink.font = `700 ${15 * unit}px system-ui, sans-serif`
    for (const [axis, sign, x, y] of [[across, 1, 40 * unit, height / 2], [across, -1, width - 16 * unit, height / 2], ['y', 1, width / 2, 18 * unit], ['y', -1, width / 2, height - 42 * unit]])
      label(ink, sideOf(this.model.scene, axis, sign), x, y, '#ffd9a0')
  }

  drawGrid(ink) {
    const { template, hole, hovered } = this.model, spacing = template.guide.spacing
    const pitch = Math.hypot(...['x', 'y'].map((axis, i) => this.pixel(template.place({ column: 1, row: 0 }))[i] - this.pixel(template.place({ column: 0, row: 0 }))[i]))
    for (let column = 0; column < template.columns; column++)
      for (let row = 0; row < template.rows; row++) ring(ink, this.pixel(template.place({ column, row })), row % 2 ? 0.9 : 1.4, GRID, 1, true)
    ink.font = `600 ${Math.min(11, 0.45 * pitch / ink.unit + 3) * ink.unit}px system-ui, sans-serif`
    for (let column = 0; column < template.columns; column++)
      label(ink, columnName(column), ...this.pixel(template.place({ column, row: template.rows - 1 }).addScaledVector(template.up, 0.9 * spacing)), GRID)
    for (let row = 0; row < template.rows; row += 2)
      for (const [column, side] of [[0, -0.9], [template.columns - 1, 0.9]])
        label(ink, `${1 + row / 2}`, ...this.pixel(template.place({ column, row }).addScaledVector(template.along, side * spacing)), GRID)
    if (hovered) this.drawHole(ink, hovered, 'rgba(255, 255, 255, 0.8)', 1.2)
    if (hole) this.drawHole(ink, hole, CHOSEN, 2.5)
  }

  drawHole(ink, hole, colour, width) {
    const [x, y] = this.pixel(this.model.template.place(hole))
    ring(ink, [x, y], 8, colour, width)
    label(ink, this.model.template.name(hole), x, y + 17 * ink.unit, colour) // below the hole, because the bevel's arrow is initially above it
  }

  /** Draws the chosen hole's axis in the sagittal image. */
  drawAxis(ink) {
    const { template, hole } = this.model
    this.drawPlate(ink, template)
    if (!hole) return
    ink.strokeStyle = 'rgba(55, 208, 255, 0.55)'
    ink.lineWidth = ink.unit
    ink.setLineDash([5 * ink.unit, 5 * ink.unit])
    ink.beginPath()
    ink.moveTo(...this.pixel(template.place(hole)))
    ink.lineTo(...this.pixel(template.onAxis(hole, 0.2)))
    ink.stroke()
    ink.setLineDash([])
  }

  /** Draws the template from the side. */
  drawPlate(ink, template) {
    const corner = (row, depth) => this.pixel(template.place({ column: 0, row }).addScaledVector(template.normal, depth)), [low, high] = [corner(-1, 0), corner(template.rows, template.guide.thickness)]
    ink.fillStyle = 'rgba(159, 216, 255, 0.22)'
    ink.fillRect(low[0], low[1], high[0] - low[0], high[1] - low[1])
    ink.font = `${11 * ink.unit}px system-ui, sans-serif`
    label(ink, t('slice.template'), (low[0] + high[0]) / 2, Math.min(low[1], high[1]) - 10 * ink.unit, GRID)
  }

  drawNeedles(ink) {
    this.model.needles.forEach((needle, i) => {
      const points = needle.line?.places ?? []
      if (points.length === 0 || !points.some((point) => this.isNear(point))) return
      for (const [colour, width] of [['rgba(4, 8, 12, 0.7)', 5], ['#f5f8fb', 2.4]]) {
        ink.strokeStyle = colour
        ink.lineWidth = width * ink.unit
        ink.beginPath()
        points.forEach((point, k) => ink[k ? 'lineTo' : 'moveTo'](...this.pixel(point)))
        ink.stroke()
      }
      ring(ink, this.pixel(points.at(-1)), 3.5, hubColour(i), 2, true)
    })
  }

  /** Draws an arrow at each needle in the direction that its bevel faces. */
  drawBevels(ink, echo) {
    this.model.bevels.forEach((bevel, i) => {
      const place = bevel && echo.crossing(this.model.needles[i].line)
      if (!place) return
      const [x, y] = echo.toPixel(place.x, place.y), [dx, dy] = [-bevel.x, -bevel.y], length = Math.hypot(dx, dy) || 1, [u, v] = [dx / length, dy / length], unit = ink.unit
      ink.strokeStyle = ink.fillStyle = BEVEL
      ink.lineWidth = 2 * unit
      ink.beginPath()
      ink.moveTo(x + 4 * unit * u, y + 4 * unit * v)
      ink.lineTo(x + 20 * unit * u, y + 20 * unit * v)
      ink.stroke()
      ink.beginPath()
      ink.moveTo(x + 27 * unit * u, y + 27 * unit * v)
      ink.lineTo(x + unit * (18 * u - 5 * v), y + unit * (18 * v + 5 * u))
      ink.lineTo(x + unit * (18 * u + 5 * v), y + unit * (18 * v - 5 * u))
      ink.fill()
    })
  }

  /** Draws a seed: solid if it is in this slice, faint otherwise. */
  drawSeed(ink, { position, direction }) {
    const centre = new THREE.Vector3(...position), half = new THREE.Vector3(...direction).multiplyScalar(this.model.seedLength / 2)
    ink.globalAlpha = this.isNear(centre) ? 1 : 0.3
    if (this.isAxial) {
      if (this.isNear(centre)) ring(ink, this.pixel(centre), 4.4, HALO, 1, true)
      ring(ink, this.pixel(centre), 3.4, SEED, 1, true)
    } else
      for (const [colour, width] of [[HALO, 7], [SEED, 4.5]]) {
        ink.strokeStyle = colour
        ink.lineWidth = width * ink.unit
        ink.beginPath()
        ink.moveTo(...this.pixel(centre.clone().sub(half)))
        ink.lineTo(...this.pixel(centre.clone().add(half)))
        ink.stroke()
      }
    ink.globalAlpha = 1
  }

  drawPlanned(ink, point) {
    ink.globalAlpha = this.isNear(point) ? 1 : 0.22
    ring(ink, this.pixel(point), 4.2, PLANNED, 1.6)
    ink.globalAlpha = 1
  }

  drawTarget(ink, point) {
    const [x, y] = this.pixel(point)
    ink.globalAlpha = this.distance(point) < 0.004 ? 1 : 0.45
    ring(ink, [x, y], 6.5, HALO, 4)
    ring(ink, [x, y], 6.5, TARGET, 1.8)
    ring(ink, [x, y], 1.6, TARGET, 1, true)
    ink.globalAlpha = 1
  }
}
