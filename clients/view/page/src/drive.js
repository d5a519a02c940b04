// Manual control of a needle: combines pads, keys and a gamepad into one command, which is sent while this page holds the needle.
import { speedAt, wordsAt } from './age.js'
import { said, t } from './words/words.js'

const PERIOD = 30 // ms between commands
const SLOW = 0.25
const KEYS = { KeyW: [2, 1], KeyS: [2, -1], ArrowRight: [0, -1], ArrowLeft: [0, 1], ArrowUp: [1, 1], ArrowDown: [1, -1],
               KeyI: [3, -1], KeyK: [3, 1], KeyJ: [4, 1], KeyL: [4, -1], KeyD: [5, 1], KeyA: [5, -1] }
const DEAD = 0.12 // dead zone of a gamepad stick, as a fraction
export const TOUCH = matchMedia('(pointer: coarse)').matches // a phone or tablet, without keys
const HELP = t(TOUCH ? 'drive.help.touch' : 'drive.help')
const HOLD = 800 // ms for which a button must be held down; keep equal to the value in style.css

/** Returns the code of a command key. A letter goes by what is printed on the key, so that Z and Y are not swapped on a German keyboard; the steering
 * keys go by their position. */
export const actionOf = ({ key, code }) => (/^[a-z]$/i.test(key) ? `Key${key.toUpperCase()}` : code)

/** Takes the focus off a button clicked with a pointer, so that the space bar does not press it again. Used with the keyboard, a button keeps the focus. */
export const leave = ({ detail, currentTarget }) => { if (detail > 0) currentTarget.blur() }

/** A self-centring pad. `value` is [x, y] from -1 to 1, with y up. */
class Spring {
  constructor(element, horizontal, vertical) {
    this.element = element
    this.value = [0, 0]
    const set = (event) => {
      const box = element.getBoundingClientRect(), half = Math.min(box.width, box.height) / 2 < 20 ? Math.max(box.width, box.height) / 2 : Math.min(box.width, box.height) / 2
      const x = horizontal ? (event.clientX - box.left - box.width / 2) / (horizontal && !vertical ? box.width / 2 : half) : 0
      const y = vertical ? -(event.clientY - box.top - box.height / 2) / (vertical && !horizontal ? box.height / 2 : half) : 0
      this.move(Math.max(-1, Math.min(1, x)), Math.max(-1, Math.min(1, y)))
    }
    element.addEventListener('pointerdown', (event) => { element.setPointerCapture(event.pointerId); this.held = true; set(event) })
    element.addEventListener('pointermove', (event) => { if (this.held) set(event) })
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture']) element.addEventListener(end, () => this.rest())
  }

  rest() {
    this.held = false
    this.move(0, 0)
  }

  move(x, y) {
    this.value = [x, y]
    this.element.style.setProperty('--x', x)
    this.element.style.setProperty('--y', -y)
  }
}

/** A button that acts only after being held down for HOLD. */
class Hold {
  constructor(button, act) {
    Object.assign(this, { button, act, timer: null })
    button.addEventListener('pointerdown', () => this.press())
    for (const end of ['pointerup', 'pointerleave', 'pointercancel', 'blur']) button.addEventListener(end, () => this.rest())
    button.addEventListener('keydown', (event) => { if (['Space', 'Enter'].includes(event.code)) { event.preventDefault(); this.press() } })
    button.addEventListener('keyup', () => this.rest())
  }

  press() {
    if (this.timer !== null) return
    this.button.classList.add('held')
    this.timer = setTimeout(() => { this.button.classList.remove('held'); this.act() }, HOLD) // once per press
  }

  rest() {
    clearTimeout(this.timer)
    this.timer = null
    this.button.classList.remove('held')
  }
}

export class Drive {
  constructor(link, age, elements) {
    this.link = link
    this.elements = elements
    this.send = (command, number) => link.steer(command, number) // replaced by the probe: see probe.js
    this.age = age        // age of the picture
    this.limit = () => 1  // allowed fraction of the forward speed; replaced by procedure mode
    this.letGo = () => link.release() // lets go of the needle; replaced by procedure mode
    this.needle = 0       // the needle that the "Drive" button takes
    this.pressed = new Set()
    this.driving = false  // true while this page holds the needle
    this.steering = false // true while this page can move the needle
    this.lost = ''        // why this page lost the needle without releasing it
    this.reset = new Hold(elements.reset, () => link.reset())
    this.lever = new Spring(elements.lever, false, true)
    this.pad = new Spring(elements.pad, true, true)
    this.roll = new Spring(elements.roll, true, false)
    elements.tilt.addEventListener('change', () => { elements.does.textContent = t(elements.tilt.checked ? 'pad.tilt' : 'pad.move') })
    addEventListener('blur', () => this.rest())
    setInterval(() => { if (this.driving) this.send(this.command(), this.age.count(performance.now())) }, PERIOD)
  }

  /** Handles a key. Returns true if it steers the needle. Also handles key releases after this page has let go of the needle. */
  key(event, down) {
    this.slow = event.shiftKey
    if (!down) this.pressed.delete(event.code)
    if (event.code === 'KeyR' && (this.steering || !down)) {
      if (down) this.reset.press()
      else this.reset.rest()
      return this.steering
    }
    if (!(event.code in KEYS) || !this.steering) return false
    if (down && !event.repeat) this.pressed.add(event.code) // a key already down before the needle was taken must be pressed again
    return true
  }

  /** Clears all inputs, so that a missed key release cannot move the needle later. */
  rest() {
    this.pressed.clear()
    for (const held of [this.lever, this.pad, this.roll, this.reset]) held.rest()
  }

  /** Returns right, up, forward, pitch, yaw and roll. The page looks along the needle, so x points to the left. */
  command() {
    const c = [0, 0, 0, 0, 0, 0], [x, y] = this.pad.value
    if (!this.steering) return c
    for (const code of this.pressed) c[KEYS[code][0]] += KEYS[code][1]
    c[2] += this.lever.value[1]
    if (this.elements.tilt.checked) { c[3] -= y; c[4] -= x } else { c[0] -= x; c[1] += y }
    c[5] += this.roll.value[0]
    this.addGamepad(c)
    const part = (this.slow ? SLOW : 1) * speedAt(this.age.at(performance.now()))
    if (c[2] > 0) c[2] = Math.min(c[2], 1) * this.limit()
    return c.map((v) => Math.max(-1, Math.min(1, v)) * part)
  }

  addGamepad(c) {
    const pad = navigator.getGamepads?.().find((p) => p)
    if (!pad) return
    const axis = (i) => (Math.abs(pad.axes[i] ?? 0) > DEAD ? pad.axes[i] : 0), button = (i) => pad.buttons[i]?.value ?? 0
    c[0] -= axis(0)
    c[1] -= axis(1)
    c[3] += axis(3)
    c[4] -= axis(2)
    c[2] += button(7) - button(6)
    c[5] += button(5) - button(4)
  }

  toggle() {
    if (this.elements.take.disabled) return
    if (!this.driving) return this.take()
    this.asked = true
    this.lost = ''
    this.letGo()
  }

  take() {
    this.asked = true
    this.lost = ''
    this.link.take(this.needle)
  }

  /** Shows the controls. `status` comes from trocar-view, `state` from stateOf. The needle moves only while the live picture is shown, not while the
   * page shows the past or receives no data. */
  show(status, state) {
    const { take, note, controls } = this.elements, rests = status.state === 'resting', past = state.name === 'past', driving = status.drives && status.alive
    if (this.driving && !driving && !this.asked) this.lost = t('drive.lost')
    if (this.lost && !this.driving && (status.lost || ['unconnected', 'refused'].includes(state.name))) this.lost = t('drive.lost.why', { reason: status.lost ? said(status.lost) : t('drive.unconnected') })
    if (driving !== this.driving) this.asked = false
    this.driving = driving
    this.steering = driving && ['live', 'stale'].includes(state.name) && !['leaving', 'resting', 'taking'].includes(status.state)
    if (!this.steering) this.rest()
    controls.hidden = !this.driving
    controls.inert = !this.steering
    take.textContent = t(this.driving ? (this.lies ? 'drive.leave' : 'drive.release') : rests || this.lies ? 'drive.takeAgain' : 'take')
    take.title = t(this.driving && this.lies ? 'drive.leave.title' : 'take.title')
    take.classList.toggle('held', this.driving)
    take.disabled = !this.driving && (state.name !== 'live' || status.driven || status.owned === 'elsewhere')
    note.textContent = this.driving ? (past ? t('drive.past') : !this.steering ? t('drive.still') : wordsAt(this.age.at(performance.now())) || HELP) : this.lost ? `${this.lost}${rests ? ` ${t('drive.rests')}` : ''}` : this.reason(status, state)
  }

  /** Returns why the needle cannot be taken. */
  reason(status, { name, kind }) {
    if (name === 'past' && kind === 'past') return t('drive.goLive')
    if (name !== 'live') return ''
    if (status.driven) return t(status.needle === this.needle ? 'drive.other' : 'drive.other.needle', { page: status.driver, needle: status.needle })
    return status.owned === 'elsewhere' ? t('drive.device') : ''
  }
}
