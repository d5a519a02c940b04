// Shows the dose: isodose lines on the slices, the dose-volume histogram and its statistics.
import * as THREE from 'three'
import { DOSES, ISODOSE, OTHER_ORGANS } from '../colours.js'
import { t } from '../words/words.js'

const WIDTH = 300, HEIGHT = 118, LEFT = 42, RIGHT = 6, TOP = 6, BOTTOM = 27
const STATES = [ // the states shown side by side
  { key: 'planned', name: t('dose.plan'), title: t('dose.plan.title'), colour: DOSES.planned, dash: '2 3' },
  { key: 'now', name: t('dose.now'), title: t('dose.now.title'), colour: DOSES.now, dash: '' },
  { key: 'out', name: t('dose.out'), title: t('dose.out.title'), colour: DOSES.out, dash: '7 3' },
  { key: 'later', name: t('dose.later'), title: t('dose.later.title'), colour: DOSES.later, dash: '7 3 1 3' },
]

/** Passes the dose to the slices' shaders as a texture. */
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

const swatch = (colour, dash = '') => `<svg class="swatch" viewBox="0 0 18 3"><line y1="1.5" x2="18" y2="1.5" stroke="${colour}" stroke-width="3" stroke-dasharray="${dash}"/></svg>`

/** Returns the target's curve in each state, and the current curves of the other organs. */
function curvesOf(organs) {
  const target = organs.find((organ) => organ.target), others = organs.filter((organ) => !organ.target)
  return [...(target ? STATES.filter(({ key }) => target[key]).map(({ key, name, colour, dash }) => ({ values: target[key].curve, name: `${target.name}, ${name}`, colour, dash })) : []),
          ...others.map((organ, i) => ({ values: organ.now.curve, name: `${organ.name}, ${t('dose.now')}`, colour: OTHER_ORGANS[i], dash: '' }))]
}

function histogram({ organs, top, prescription }) {
  const x = (part) => LEFT + part / top * (WIDTH - LEFT - RIGHT), y = (part) => TOP + (1 - part) * (HEIGHT - TOP - BOTTOM)
  const line = (x1, y1, x2, y2, style) => `<line x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}" ${style}/>`
  const grid = [0, 0.5, 1].map((part) => line(LEFT, y(part), WIDTH - RIGHT, y(part), 'class="grid"') + `<text x="${LEFT - 4}" y="${y(part) + 3}" text-anchor="end">${100 * part}</text>`)
  const doses = ISODOSE.map(({ level, colour }) => line(x(level), TOP, x(level), HEIGHT - BOTTOM, `stroke="${colour}" stroke-width="1.5"`))
  const ticks = Array.from({ length: top + 1 }, (_, i) => `<text x="${x(i)}" y="${HEIGHT - BOTTOM + 11}" text-anchor="${i === top ? 'end' : 'middle'}">${Math.round(i * prescription)}</text>`)
  const curves = curvesOf(organs).map(({ values, colour, dash }) => `<polyline points="${values.map((volume, k) => `${x(top * k / (values.length - 1)).toFixed(1)},${y(volume).toFixed(1)}`).join(' ')}" fill="none" stroke="${colour}" stroke-width="1.8" stroke-dasharray="${dash}"/>`)
  return `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label="${t('dose.histogram')}">${[...grid, ...doses, ...ticks, ...curves].join('')}
    <text x="${(LEFT + WIDTH - RIGHT) / 2}" y="${HEIGHT - 4}" text-anchor="middle">${t('dose.axis')}</text>
    <text transform="translate(10 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" text-anchor="middle">${t('dose.volume')}</text></svg>`
}

/** Rows of the table: name with unit, value, and planning aim: that of GEC-ESTRO (Salembier et al. 2007), as in the tasks and in `trocar.brachy`. */
const gray = (dose) => `${Math.round(dose)}`, percent = (part) => `${Math.round(100 * part)}`
const TARGET_ROWS = [['D90, Gy', (f) => gray(f.d90), (p) => t('dose.over', { value: gray(p) })], ['V100, %', (f) => percent(f.v100), () => t('dose.over', { value: 95 })],
                     ['V150, %', (f) => percent(f.v150), () => t('dose.under', { value: 50 })], ['V200, %', (f) => percent(f.v200), () => '']]
const OTHER_ROWS = { urethra: [['D10, Gy', (f) => gray(f.d10), (p) => t('dose.under', { value: gray(1.5 * p) })], ['D30, Gy', (f) => gray(f.d30), () => '']], rectum: [['V100, cm³', (f) => f.v100cm3.toFixed(1), () => '']] }

/** Returns the statistics, with the states side by side. */
function figures({ organs, prescription }) {
  const states = STATES.filter(({ key }) => organs.some((organ) => organ[key])), escape = (text) => text.replace(/[&<>]/g, (c) => `&#${c.charCodeAt(0)};`)
  const rows = organs.flatMap((organ) => {
    const kind = Object.keys(OTHER_ROWS).find((name) => organ.name.toLowerCase().includes(name)), list = organ.target ? TARGET_ROWS : OTHER_ROWS[kind] ?? []
    return list.map(([name, show, aim]) => `<tr><th scope="row">${organ.target ? '' : `${escape(organ.name)} `}${name}</th>${states.map(({ key }) => `<td>${organ[key] ? show(organ[key]) : ''}</td>`).join('')}<td>${aim(prescription)}</td></tr>`)
  })
  const heads = states.map(({ name, title }) => `<th scope="col" title="${title}">${name}</th>`).join('')
  return `<table class="figures"><thead><tr><td></td>${heads}<th scope="col">${t('dose.aim')}</th></tr></thead><tbody>${rows.join('')}</tbody></table>`
}

/** Returns HTML with the histogram, the legend and the statistics. */
export function describeDose(dose) {
  if (!dose) return `<p class="quiet">${t('dose.computing')}</p>`
  const { seeds, strength, source, prescription, organs, swelling } = dose, plain = (text) => text.replace(/[&<>]/g, '')
  const lines = ISODOSE.map(({ level, colour }) => `<span>${swatch(colour)}${gray(level * prescription)} Gy</span>`).join(' ')
  const curves = curvesOf(organs).map(({ name, colour, dash }) => `<span>${swatch(colour, dash)}${plain(name)}</span>`).join(' ')
  if (seeds === 0 && !organs.some(({ planned }) => planned)) return `<h2>${t('dose.label')}</h2><p class="quiet">${t('dose.none', { dose: gray(prescription), source: plain(source), strength })}</p>`
  const volumes = organs.map(({ name, volume }) => `${plain(name)} ${volume.toFixed(0)} cm³`).join(', ')
  return `<h2>${t('dose.seeds', { count: seeds })}</h2><p class="quiet">${t('dose.source', { source: plain(source), strength, dose: gray(prescription), volumes })}</p>
    <p class="key">${t('dose.lines')} ${lines}</p>${organs.length ? `${figures(dose)}<p class="quiet">${t('dose.states', { swelling })}</p>${histogram(dose)}<p class="key">${curves}</p>` : `<p class="quiet">${t('dose.regionless')}</p>`}`
}
