// The colours of anatomy, contacts and displacement. Both themes share them, except for the background. Where items differ by colour alone, people
// with any type of dichromacy can tell them apart: see tests/view/colours_test.mjs.

/** A perceptually uniform scale from dark blue to yellow, based on matplotlib's viridis. */
const RAMP = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]]

/** Returns the colour at a fraction of the scale, with r, g and b from 0 to 1. */
export function ramp(fraction) {
  const x = Math.min(Math.max(fraction, 0), 1) * (RAMP.length - 1), i = Math.min(Math.floor(x), RAMP.length - 2), f = x - i
  return [0, 1, 2].map((k) => (RAMP[i][k] + f * (RAMP[i + 1][k] - RAMP[i][k])) / 255)
}

export const rampCss = `linear-gradient(90deg, ${RAMP.map((c) => `rgb(${c})`).join(',')})`

const REGIONS = [['prostate', '#c9677c'], ['gland', '#c9677c'], ['urethra', '#e0b04a'], ['bladder', '#7fa6d9'], ['rectum', '#b98a6a'], ['seminal', '#d89a70']]
const OTHERS = ['#8aa4c8', '#9ab87a', '#c49ad0', '#d0b080']

export function regionColour(region, index) {
  if (region.bone) return '#e8dfc8'
  return REGIONS.find(([name]) => (region.organ ?? region.name).toLowerCase().includes(name))?.[1] ?? OTHERS[index % OTHERS.length]
}

export const CONTACT = { 0: '#3ddc97', 1: '#ff9f43', '-1': '#5b8cff' } // by contact state: sticking, sliding in, sliding out
export const TRACK = '#e63946' // tracks that needles have cut
export const GUIDED = '#e762ba' // contacts with a guide
export const AXES = ['#fb5e5f', '#1ea86c', '#4895f4'] // x, y and z
export const TIMING = ['#c28901', '#8c6bd6'] // compute, lateness

const HUBS = ['#2c7fb8', '#d9822b', '#3fa672', '#af78fb']

/** Returns the colour of a needle's hub. */
export const hubColour = (needle) => HUBS[needle % HUBS.length]

// `level`: multiple of the prescription
export const ISODOSE = [{ level: 1, colour: '#ffd23f' }, { level: 1.5, colour: '#ff841e' }, { level: 2, colour: '#ff3864' }]
export const SEED = '#94ff95', PLANNED = '#aa83f5', TARGET = '#ffffff', CHOSEN = '#37d0ff', BEVEL = '#f2ce39'

/** Dose-volume curves: the gland as planned, now, with the needles out, and later; then two other organs. */
export const DOSES = { planned: '#a97be8', now: '#e05b73', out: '#bd8b1a', later: '#7089ab' }, OTHER_ORGANS = ['#339575', '#8d8f96']
