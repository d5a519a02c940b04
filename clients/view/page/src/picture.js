// Composes a picture for publication: the needle in the tissue, the slice, values and scales.
import { CONTACT, GUIDED, rampCss, TRACK } from './colours.js'
import { CONTACT_NUMBERS } from './decode.js'
import { FORCE_SCALE } from './needle.js'
import { t } from './words/words.js'

const FINE = 2          // supersampling factor for anti-aliasing
const MOST = 8192       // pixels per side that most GPUs support
export const SIZE = { width: 1600, height: 1000 }

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim()

/** Returns the layout of a picture of `width` x `height`. Slice and legend are in a column on the right or, if the picture is taller than wide, in a
 * row below. */
export function arrange({ width, height }) {
  const beside = width >= 1.1 * height, side = Math.round(beside ? Math.min(0.45 * height, 0.34 * width) : Math.min(0.36 * height, 0.48 * width))
  const margin = Math.round(0.05 * side), band = side + 2 * margin
  return { width, height, side, margin, unit: side / 450,
           stage: beside ? { width: width - band, height } : { width, height: height - band },
           slice: { left: width - side - margin, top: beside ? margin : height - side - margin },
           legend: beside ? { left: width - side - margin, top: band + margin } : { left: margin, top: height - side - margin } }
}

/** Returns a layout like that of `arrange`, but with the 3D view's on-screen aspect ratio. */
export function arrangeLike({ clientWidth, clientHeight }) {
  const { height } = SIZE, plan = arrange(SIZE), stage = { width: Math.round(height * clientWidth / clientHeight), height }, width = stage.width + SIZE.width - plan.stage.width
  const shift = ({ left, top }) => ({ left: left + width - SIZE.width, top })
  return { ...plan, width, stage, slice: shift(plan.slice), legend: shift(plan.legend) }
}

/** Renders a PNG with the sizes in `plan`, whatever the size of the screen. `shown`: the needle whose values are shown; `label`: its index if there are
 * several. */
export function compose(plan, { stage, echo, shown, history, time, range, label }) {
  const canvas = document.createElement('canvas'), ink = canvas.getContext('2d'), { width, height, side, slice } = plan
  Object.assign(canvas, { width, height })
  ink.imageSmoothingQuality = 'high'
  ink.fillStyle = colour('--ground')
  ink.fillRect(0, 0, width, height)
  // The WebGL drawing buffer is valid until this task ends.
  const fine = Math.min(FINE, MOST / Math.max(plan.stage.width, plan.stage.height))
  ink.drawImage(stage.drawAt(plan.stage.width, plan.stage.height, fine), 0, 0, plan.stage.width, plan.stage.height)
  ink.fillStyle = '#06080b'
  ink.fillRect(slice.left, slice.top, side, side)
  for (const layer of echo.drawAt(side, side, 1, plan.unit)) ink.drawImage(layer, slice.left, slice.top, side, side)
  ink.strokeStyle = colour('--line')
  ink.lineWidth = plan.unit
  ink.strokeRect(slice.left, slice.top, side, side)
  drawLegend(ink, plan, { stage, shown, history, time, range, label })
  stage.resize()
  echo.resize()
  return new Promise((done) => { canvas.toBlob(done, 'image/png') })
}

function drawLegend(ink, { legend: { left, top }, side, unit, stage: { height } }, { stage, shown, history, time, range, label }) {
  const at = history.sampleNear(time), value = (column) => history.columns[column][at], small = `${15 * unit}px system-ui, sans-serif`
  const text = (words, x, y, font = small, style = '--text') => { ink.font = font; ink.fillStyle = colour(style); ink.fillText(words, left + x * unit, top + y * unit) }
  const numbers = [[t('picture.time'), `${time.toFixed(3)} s`], [t('depth'), at < 0 ? '–' : `${(1e3 * value(7)).toFixed(1)} mm`],
                   [t('force'), at < 0 ? '–' : `${Math.hypot(value(1), value(2), value(3)).toFixed(2)} N`], [t('contacts'), shown ? `${shown.contacts.length / CONTACT_NUMBERS}` : '–'], ...label ? [[t('picture.needle'), label]] : []]
  numbers.forEach(([name, number], i) => {
    text(name, 0, 22 + 32 * i, small, '--muted')
    text(number, 100, 22 + 32 * i, `600 ${22 * unit}px system-ui, sans-serif`)
  })

  text(t('displacement'), 0, 172, small, '--muted')
  const bar = ink.createLinearGradient(left + 120 * unit, 0, left + 270 * unit, 0), stops = rampCss.match(/rgb\([^)]*\)/g)
  stops.forEach((stop, i) => bar.addColorStop(i / (stops.length - 1), stop))
  ink.fillStyle = bar
  ink.fillRect(left + 120 * unit, top + 162 * unit, 150 * unit, 10 * unit)
  text(`0 – ${+(1e3 * range).toPrecision(2)} mm`, 282, 172)

  const kinds = [[t('contact.sticks'), CONTACT[0]], [t('contact.in'), CONTACT[1]], [t('contact.out'), CONTACT[-1]], [t('contact.tip'), colour('--tip')], ...(stage.scene.guides.length ? [[t('contact.guide'), GUIDED]] : []), ...(stage.tracks.empty ? [] : [[t('track'), TRACK]])]
  let x = 0
  for (const [name, dot] of kinds) {
    ink.fillStyle = dot
    ink.beginPath()
    if (dot === TRACK) ink.rect(left + x * unit, top + 197.5 * unit, 10 * unit, 3 * unit)
    else ink.arc(left + (x + 5) * unit, top + 199 * unit, 5 * unit, 0, 2 * Math.PI)
    ink.fill()
    text(name, x + 15, 204)
    x += 15 + ink.measureText(name).width / unit + 18
  }

  const perPixel = stage.metresPerPixel(height), length = [0.05, 0.02, 0.01, 0.005, 0.002, 0.001].find((l) => l / perPixel < 0.5 * side) ?? 0.001
  ink.fillStyle = colour('--text')
  ink.fillRect(left, top + 231 * unit, length / perPixel, 2.5 * unit)
  text(t('scale', { length: 1e3 * length, force: +(length / FORCE_SCALE).toPrecision(3) }), length / perPixel / unit + 12, 237)
}

export function save(blob, name) {
  const anchor = document.createElement('a')
  anchor.href = URL.createObjectURL(blob)
  anchor.download = name
  anchor.click()
  setTimeout(() => URL.revokeObjectURL(anchor.href), 1000)
}
