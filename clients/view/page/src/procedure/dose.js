// The dose: isodose lines on the slices, the dose-volume histogram and its figures.
import * as THREE from 'three'
import { ISODOSE } from '../colours.js'

const WIDTH = 300, HEIGHT = 118, LEFT = 30, RIGHT = 6, TOP = 6, BOTTOM = 27
const COLOURS = ['#d9607a', '#c9952b', '#5a8fd0'] // of the organs' curves
const percent = (part) => `${Math.round(100 * part)} %`
const gray = (dose) => `${Math.round(dose)} Gy`

/** Gives the slices the dose as a texture. */
export function shadeSlices(slices, dose) {
  const [x, y, z] = dose.counts, texture = new THREE.Data3DTexture(dose.levels, z, y, x)
  Object.assign(texture, { format: THREE.RedFormat, type: THREE.UnsignedByteType, minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter, unpackAlignment: 1, needsUpdate: true })
  for (const slice of slices) {
    const { doses } = slice
    doses.dose.value?.dispose()
    doses.dose.value = texture
    doses.doseOrigin.value.fromArray(dose.origin).addScalar(-dose.spacing / 2) // corner of the first voxel
    doses.doseSize.value.fromArray(dose.counts).multiplyScalar(dose.spacing)
    doses.doseTop.value = dose.seeds ? dose.top : 0
    slice.dirty = true
  }
}

const swatch = (colour) => `<svg class="swatch" viewBox="0 0 14 3"><rect width="14" height="3" fill="${colour}"/></svg>`

function histogram({ organs, top, prescription }) {
  const x = (part) => LEFT + part / top * (WIDTH - LEFT - RIGHT), y = (part) => TOP + (1 - part) * (HEIGHT - TOP - BOTTOM)
  const line = (x1, y1, x2, y2, style) => `<line x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}" ${style}/>`
  const grid = [0, 0.5, 1].map((part) => line(LEFT, y(part), WIDTH - RIGHT, y(part), 'class="grid"') + `<text x="${LEFT - 4}" y="${y(part) + 3}" text-anchor="end">${100 * part}</text>`)
  const doses = ISODOSE.map(({ level, colour }) => line(x(level), TOP, x(level), HEIGHT - BOTTOM, `stroke="${colour}" stroke-width="1.5"`))
  const ticks = Array.from({ length: top + 1 }, (_, i) => `<text x="${x(i)}" y="${HEIGHT - BOTTOM + 11}" text-anchor="${i === top ? 'end' : 'middle'}">${Math.round(i * prescription)}</text>`)
  const curves = organs.map(({ curve }, i) => `<polyline points="${curve.map((volume, k) => `${x(top * k / (curve.length - 1)).toFixed(1)},${y(volume).toFixed(1)}`).join(' ')}" fill="none" stroke="${COLOURS[i]}" stroke-width="2"/>`)
  return `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="Dose-volume histogram">${[...grid, ...doses, ...ticks, ...curves].join('')}
    <text x="${(LEFT + WIDTH - RIGHT) / 2}" y="${HEIGHT - 4}" text-anchor="middle">at least this dose (Gy) in this part of the volume (%)</text></svg>`
}

/** Rows of a name, a value of the figures, and the customary aim. */
const TARGET_ROWS = [['D90', (f) => gray(f.d90), (p) => `over ${gray(p)}`], ['V100', (f) => percent(f.v100), () => 'over 95 %'],
                     ['V150', (f) => percent(f.v150), () => 'under 60 %'], ['V200', (f) => percent(f.v200), () => 'under 20 %']]
const OTHER_ROWS = { urethra: [['D10', (f) => gray(f.d10), () => ''], ['D30', (f) => gray(f.d30), () => '']], rectum: [['V100', (f) => `${f.v100cm3.toFixed(1)} cm³`, () => 'under 1 cm³']] }

function figures({ organs, prescription }) {
  const planned = organs.some((organ) => organ.planned), escape = (text) => text.replace(/[&<>]/g, (c) => `&#${c.charCodeAt(0)};`)
  const rows = organs.flatMap((organ) => {
    const kind = Object.keys(OTHER_ROWS).find((name) => organ.name.toLowerCase().includes(name)), list = organ.target ? TARGET_ROWS : OTHER_ROWS[kind] ?? []
    return list.map(([name, show, aim]) => `<tr><th scope="row">${escape(organ.name)} ${name}</th><td>${show(organ.now)}</td>${planned ? `<td>${show(organ.planned)}</td>` : ''}<td>${aim(prescription)}</td></tr>`)
  })
  return `<table class="figures"><thead><tr><td></td><th>now</th>${planned ? '<th>plan</th>' : ''}<th>usual aim</th></tr></thead><tbody>${rows.join('')}</tbody></table>`
}

/** HTML of the histogram, the legend and the figures. */
export function describeDose(dose) {
  if (!dose) return '<p class="quiet">The dose is being computed.</p>'
  const { seeds, strength, source, prescription, organs } = dose
  const lines = ISODOSE.map(({ level, colour }) => `<span>${swatch(colour)}${gray(level * prescription)}</span>`).join(' ')
  const curves = organs.map(({ name, volume }, i) => `<span>${swatch(COLOURS[i])}${name.replace(/[&<>]/g, '')}, ${volume.toFixed(0)} cm³</span>`).join(' ')
  if (seeds === 0 && !organs.some(({ planned }) => planned)) return `<h2>Dose</h2><p class="quiet">No seeds yet. Prescribed: ${gray(prescription)}, with seeds of ${source.replace(/[&<>]/g, '')}, ${strength} U each.</p>`
  return `<h2>Dose of ${seeds === 1 ? '1 seed' : `${seeds} seeds`}</h2><p class="quiet">${source.replace(/[&<>]/g, '')}, ${strength} U each; prescribed: ${gray(prescription)}.</p>
    <p class="key">Lines on the images: ${lines}</p>${organs.length ? `${figures(dose)}${histogram(dose)}<p class="key">${curves}</p>` : '<p class="quiet">The scene has no region named prostate or gland.</p>'}`
}
