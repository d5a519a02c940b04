/* Tests that the colours of the page and of reports can be told apart, with protanopia, deuteranopia and tritanopia as well, and that text and curves stand out
   from their background.
   usage: colours_test.mjs SOURCE_DIR

   Dichromacy is simulated with the matrices of G. M. Machado, M. M. Oliveira and L. A. F. Fernandes, "A physiologically-based model for simulation of color
   vision deficiency", IEEE Transactions on Visualization and Computer Graphics 15 (2009), 1291-1298, for linear RGB and severity 1. Differences are
   CIEDE2000: G. Sharma, W. Wu and E. N. Dalal, "The CIEDE2000 color-difference formula", Color Research and Application 30 (2005), 21-30, whose test data
   are used below. Contrasts are those of WCAG 2.2: 4.5 for texts (1.4.3), 3 for graphics (1.4.11). */
import assert from 'node:assert/strict'
import { readFile } from 'node:fs/promises'
import path from 'node:path'
import { pathToFileURL } from 'node:url'

const page = path.join(process.argv[2], 'clients/view/page/src')
const { AXES, BEVEL, CHOSEN, CONTACT, DOSES, GUIDED, hubColour, ISODOSE, OTHER_ORGANS, PLANNED, SEED, TARGET, TIMING, TRACK } = await import(pathToFileURL(path.join(page, 'colours.js')))

const LEAST = 10 // CIEDE2000; a just noticeable difference is about 1, and dots and lines are small
const TEXT = 4.5, GRAPHIC = 3
const VISION = {
  normal: [1, 0, 0, 0, 1, 0, 0, 0, 1],
  protanopia: [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
  deuteranopia: [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.011820, 0.042940, 0.968881],
  tritanopia: [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.303900],
}
const ULTRASOUND = '#06080b'

/* ---- formulas ---- */

/** Returns the linear RGB, 0 to 1, of a colour such as #ffd23f (IEC 61966-2-1). */
function linear(colour) {
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16) / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
}

const times = (matrix, [a, b, c]) => [0, 3, 6].map((row) => matrix[row] * a + matrix[row + 1] * b + matrix[row + 2] * c)
const simulate = (matrix, rgb) => times(matrix, rgb).map((v) => Math.min(Math.max(v, 0), 1))

/** Returns the CIELAB of linear sRGB, with white D65. */
function lab(rgb) {
  const white = [0.95047, 1, 1.08883], xyz = times([0.4124564, 0.3575761, 0.1804375, 0.2126729, 0.7151522, 0.0721750, 0.0193339, 0.1191920, 0.9503041], rgb)
  const [x, y, z] = xyz.map((v, i) => v / white[i]).map((v) => (v > 216 / 24389 ? Math.cbrt(v) : (24389 / 27 * v + 16) / 116))
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)]
}

const degrees = (b, a) => (a === 0 && b === 0 ? 0 : (Math.atan2(b, a) * 180 / Math.PI + 360) % 360)
const cos = (angle) => Math.cos(angle * Math.PI / 180), sin = (angle) => Math.sin(angle * Math.PI / 180)
const saturation = (chroma) => Math.sqrt(chroma ** 7 / (chroma ** 7 + 25 ** 7))

/** Sharma 2005, equations 2 to 22. */
function ciede2000([l1, a1, b1], [l2, a2, b2]) {
  const g = 1 + 0.5 * (1 - saturation((Math.hypot(a1, b1) + Math.hypot(a2, b2)) / 2)), c1 = Math.hypot(g * a1, b1), c2 = Math.hypot(g * a2, b2)
  const h1 = degrees(b1, g * a1), h2 = degrees(b2, g * a2), grey = c1 * c2 === 0, turn = h2 - h1
  const dh = grey ? 0 : turn > 180 ? turn - 360 : turn < -180 ? turn + 360 : turn
  const dL = l2 - l1, dC = c2 - c1, dH = 2 * Math.sqrt(c1 * c2) * sin(dh / 2), l = (l1 + l2) / 2, c = (c1 + c2) / 2, sum = h1 + h2
  const h = grey ? sum : Math.abs(turn) <= 180 ? sum / 2 : sum < 360 ? (sum + 360) / 2 : (sum - 360) / 2
  const t = 1 - 0.17 * cos(h - 30) + 0.24 * cos(2 * h) + 0.32 * cos(3 * h + 6) - 0.2 * cos(4 * h - 63)
  const sL = 1 + 0.015 * (l - 50) ** 2 / Math.sqrt(20 + (l - 50) ** 2), sC = 1 + 0.045 * c, sH = 1 + 0.015 * c * t
  const rotation = -sin(60 * Math.exp(-(((h - 275) / 25) ** 2))) * 2 * saturation(c)
  return Math.sqrt((dL / sL) ** 2 + (dC / sC) ** 2 + (dH / sH) ** 2 + rotation * (dC / sC) * (dH / sH))
}

const luminance = (colour) => times([0.2126, 0.7152, 0.0722, 0, 0, 0, 0, 0, 0], linear(colour))[0]

/** WCAG 2.2, contrast ratio. */
function contrast(one, other) {
  const [dark, light] = [luminance(one), luminance(other)].sort((a, b) => a - b)
  return (light + 0.05) / (dark + 0.05)
}

/* ---- checks ---- */

// rows 1, 4, 7, 17, 19, 25 and 34 of Sharma 2005, table 1
for (const [one, other, expected] of [
  [[50, 2.6772, -79.7751], [50, 0, -82.7485], 2.0425], [[50, -1.3802, -84.2814], [50, 0, -82.7485], 1.0000], [[50, 0, 0], [50, -1, 2], 2.3669],
  [[50, 2.5, 0], [73, 25, -18], 27.1492], [[50, 2.5, 0], [56, -27, -3], 31.9030], [[60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644],
  [[2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082]])
  assert(Math.abs(ciede2000(one, other) - expected) < 5e-5, `CIEDE2000 of ${one} and ${other}: ${ciede2000(one, other)}, not ${expected}`)
for (const matrix of Object.values(VISION)) for (const v of times(matrix, [1, 1, 1])) assert(Math.abs(v - 1) < 2e-6, 'white stays white')

/** Colours of the HTML reports, from the Python package. */
const report = await readFile(path.join(process.argv[2], 'clients/python/trocar/_page.py'), 'utf8')
const [organs, marks, [outlines]] = [/^COLOURS = .*$/m, /^PLANNED, ACHIEVED = .*$/m, /^OUTLINES = .*$/m].map((line) => line.exec(report)[0].match(/#[0-9a-f]{6}/g))
assert(organs.length === 3 && marks.length === 2)

const sets = {
  'organs, marks and outlines of reports': [...organs, ...marks, outlines],
  'contacts and tracks': [...Object.values(CONTACT), GUIDED, TRACK],
  'axes of the plots': AXES,
  'curves of the timing plot': TIMING,
  'isodose lines': ISODOSE.map(({ colour }) => colour),
  'marks on the images': [SEED, PLANNED, TARGET, CHOSEN, BEVEL],
  'hubs of needles': [0, 1, 2, 3].map(hubColour),
  'curves of the histogram': [...Object.values(DOSES), ...OTHER_ORGANS],
}

const pairs = (list) => list.flatMap((one, i) => list.slice(i + 1).map((other) => [one, other]))
const faults = []
for (const [name, colours] of Object.entries(sets))
  for (const [vision, matrix] of Object.entries(VISION)) {
    const seen = pairs(colours).map(([one, other]) => ({ one, other, difference: ciede2000(...[one, other].map((colour) => lab(simulate(matrix, linear(colour))))) }))
    const least = seen.reduce((a, b) => (a.difference < b.difference ? a : b)), words = `${name}, ${vision}: ${least.one} and ${least.other} differ by ${least.difference.toFixed(1)}`
    console.log(words)
    if (least.difference < LEAST) faults.push(words)
  }

/** Returns a theme's colours, from the first rule in style.css that has this selector. */
async function theme(selector) {
  const css = await readFile(path.join(page, 'style.css'), 'utf8'), start = css.indexOf(`${selector} {`), rule = css.slice(start, css.indexOf('}', start))
  assert(start >= 0, selector)
  return Object.fromEntries([...rule.matchAll(/--(\w+): (#[0-9a-f]{6})/g)].map(([, name, colour]) => [name, colour]))
}

const need = (name, colour, ground, least) => { if (contrast(colour, ground) < least) faults.push(`${name}: contrast of ${colour} on ${ground} is ${contrast(colour, ground).toFixed(2)}, not ${least}`) }
for (const [name, { text, muted, accent, event, alarm, good, panel, ground }] of [['dark', await theme(':root')], ['light', await theme(':root[data-theme=light]')]]) {
  for (const under of [panel, ground]) for (const colour of [text, muted, event, alarm, good]) need(`text, ${name}`, colour, under, TEXT)
  for (const colour of [accent, ...AXES, ...TIMING, ...Object.values(DOSES), ...OTHER_ORGANS]) need(`graphics, ${name}`, colour, panel, GRAPHIC)
}
for (const colour of [...sets['isodose lines'], ...sets['marks on the images']]) need('on the ultrasound image', colour, ULTRASOUND, GRAPHIC)
for (const colour of sets['organs, marks and outlines of reports']) need('on the figures of reports', colour, '#ffffff', GRAPHIC)
assert.deepEqual(faults, [])
console.log('passed')
