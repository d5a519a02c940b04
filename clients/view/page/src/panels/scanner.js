// The computed ultrasound images: requests them from trocar-view, and shows the scanner's controls.
import { t } from '../words/words.js'

const RENEWED = 1000 // ms between identical requests; trocar-view stops computing two seconds after the last one
const PERIOD = 40 // ms, shortest time between two requests
const DEPTHS = [0, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1] // m; 0 for deep enough to cover the gland
const element = (id) => document.getElementById(id)

export class Scanner {
  /** `slices`: the axial and the sagittal Echo; `both`: returns whether the sagittal image is visible. */
  constructor({ link, slices, both }) {
    Object.assign(this, { link, slices, both, depth: 0, asked: '', askedAt: -Infinity })
    for (const depth of DEPTHS) element('scan-depth').append(new Option(depth ? `${(1e3 * depth).toFixed(0)} mm` : t('scan.auto'), depth))
    for (const id of ['scan-gain', 'scan-range', 'scan-depth', 'scan-marks']) element(id).addEventListener('input', () => this.set())
    this.set()
  }

  /** Applies the settings of the scanner's controls. */
  set() {
    const gain = Number(element('scan-gain').value), range = Number(element('scan-range').value)
    this.depth = Number(element('scan-depth').value)
    element('scan-gain-text').textContent = `${gain > 0 ? '+' : ''}${gain} dB`
    element('scan-range-text').textContent = `${range} dB`
    for (const slice of this.slices) Object.assign(slice, { look: { gain, range }, marked: element('scan-marks').checked, dirty: true })
  }

  hear(images) {
    for (const image of images) this.slices[image.name === 'axial' ? 0 : 1].showImage(image)
  }

  /** Called in each frame. */
  ask(live, now) {
    const [axial, sagittal] = this.slices
    for (const slice of this.slices) {
      if (slice.live !== live) slice.dirty = true
      slice.live = live
    }
    const wish = [axial.place, sagittal.place, this.depth, this.both()], text = wish.join()
    if (!live || now - this.askedAt < (text === this.asked ? RENEWED : PERIOD)) return
    Object.assign(this, { asked: text, askedAt: now })
    this.link.lookAt(...wish)
  }
}
