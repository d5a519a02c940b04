// One picture of the view for papers: the needle in the tissue, the slice beside it, scale and numbers.
import { rampCss } from './colours.js'
import { FORCE_SCALE } from './needle.js'

const SLICE = 0.36 // of the picture's height

/** A PNG of what is drawn now; call it in the same task as the drawing. */
export function compose({ stage, echo, scene, history, time, range }) {
  const main = stage.renderer.domElement, canvas = document.createElement('canvas'), ink = canvas.getContext('2d')
  const { width, height } = main, unit = height / 900
  Object.assign(canvas, { width, height })
  ink.fillStyle = getComputedStyle(document.documentElement).getPropertyValue('--ground')
  ink.fillRect(0, 0, width, height)
  ink.drawImage(main, 0, 0)
  drawSlice(ink, echo, width, SLICE * height, unit)
  drawNumbers(ink, history, time, unit)
  drawScales(ink, stage, range, height, unit)
  return new Promise((done) => { canvas.toBlob(done, 'image/png') })
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name)

function drawSlice(ink, echo, width, size, unit) {
  const left = width - size - 20 * unit, top = 20 * unit
  ink.fillStyle = '#06080b'
  ink.fillRect(left, top, size, size)
  const side = Math.min(echo.canvas.width, echo.canvas.height)
  for (const layer of [echo.canvas, echo.marks]) {
    const scale = layer.width / echo.canvas.width
    ink.drawImage(layer, scale * (echo.canvas.width - side) / 2, scale * (echo.canvas.height - side) / 2, scale * side, scale * side, left, top, size, size)
  }
  ink.strokeStyle = colour('--line')
  ink.lineWidth = unit
  ink.strokeRect(left, top, size, size)
}

function drawNumbers(ink, history, time, unit) {
  const at = history.sampleIndex(time), value = (column) => history.columns[column][at]
  const lines = [`t = ${time.toFixed(3)} s`, `depth ${(1e3 * value(7)).toFixed(1)} mm`, `force ${Math.hypot(value(1), value(2), value(3)).toFixed(2)} N`]
  ink.fillStyle = colour('--text')
  ink.font = `${17 * unit}px system-ui, sans-serif`
  lines.forEach((line, i) => ink.fillText(line, 24 * unit, (38 + 24 * i) * unit))
}

function drawScales(ink, stage, range, height, unit) {
  const y = height - 30 * unit, bar = ink.createLinearGradient(24 * unit, 0, 184 * unit, 0)
  const stops = rampCss.match(/rgb\([^)]*\)/g)
  stops.forEach((stop, i) => bar.addColorStop(i / (stops.length - 1), stop))
  ink.fillStyle = bar
  ink.fillRect(24 * unit, y, 160 * unit, 8 * unit)
  ink.fillStyle = colour('--text')
  ink.font = `${13 * unit}px system-ui, sans-serif`
  ink.fillText(`displacement 0 – ${+(1e3 * range).toPrecision(2)} mm`, 24 * unit, y - 8 * unit)
  const length = 0.02 / stage.metresPerPixel() * (stage.renderer.domElement.height / stage.canvas.clientHeight), left = 230 * unit
  ink.fillRect(left, y + 3 * unit, length, 2 * unit)
  ink.fillText(`20 mm, ${0.02 / FORCE_SCALE} N`, left, y - 8 * unit)
}

export function save(blob, name) {
  const anchor = document.createElement('a')
  anchor.href = URL.createObjectURL(blob)
  anchor.download = name
  anchor.click()
  setTimeout(() => URL.revokeObjectURL(anchor.href), 1000)
}
