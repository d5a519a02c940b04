// The needle driven by hand: pads, keys and a gamepad become one command, sent while the needle is held here.

const PERIOD = 30 // ms between commands
const SLOW = 0.25
const KEYS = { KeyW: [2, 1], KeyS: [2, -1], ArrowRight: [0, -1], ArrowLeft: [0, 1], ArrowUp: [1, 1], ArrowDown: [1, -1],
               KeyI: [3, -1], KeyK: [3, 1], KeyJ: [4, 1], KeyL: [4, -1], KeyD: [5, 1], KeyA: [5, -1] }
const DEAD = 0.12 // of a gamepad's stick

/** A pad whose knob springs back: `value` [x, y] in -1 .. 1, y up. */
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

export class Drive {
  constructor(link, elements) {
    this.link = link
    this.elements = elements
    this.pressed = new Set()
    this.driving = false
    this.lever = new Spring(elements.lever, false, true)
    this.pad = new Spring(elements.pad, true, true)
    this.roll = new Spring(elements.roll, true, false)
    elements.tilt.addEventListener('change', () => { elements.does.textContent = elements.tilt.checked ? 'tilt' : 'move' })
    addEventListener('blur', () => this.rest())
    setInterval(() => { if (this.driving) link.steer(this.command()) }, PERIOD)
  }

  /** Returns whether the key is one that steers. One that comes up is forgotten whoever has the needle by then. */
  key(event, down) {
    this.slow = event.shiftKey
    if (!down) this.pressed.delete(event.code)
    if (!(event.code in KEYS) || !this.driving) return false
    if (down) this.pressed.add(event.code)
    return true
  }

  /** Nothing is held: what is let go of unseen must not move the needle later. */
  rest() {
    this.pressed.clear()
    for (const spring of [this.lever, this.pad, this.roll]) spring.rest()
  }

  /** right, up, forward, pitch, yaw, roll. The page looks along the needle, where x points to the left. */
  command() {
    const c = [0, 0, 0, 0, 0, 0], [x, y] = this.pad.value
    for (const code of this.pressed) c[KEYS[code][0]] += KEYS[code][1]
    c[2] += this.lever.value[1]
    if (this.elements.tilt.checked) { c[3] -= y; c[4] -= x } else { c[0] -= x; c[1] += y }
    c[5] += this.roll.value[0]
    this.addGamepad(c)
    return c.map((v) => Math.max(-1, Math.min(1, v)) * (this.slow ? SLOW : 1))
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

  toggle() { this.driving ? this.link.release() : this.link.take() }

  /** `status` as trocar-view sends it. */
  show(status) {
    const { take, note, controls } = this.elements
    this.driving = status.drives && status.alive
    if (!this.driving) this.rest()
    controls.hidden = !this.driving
    take.textContent = this.driving ? 'Let go' : 'Drive the needle'
    take.classList.toggle('held', this.driving)
    take.disabled = !this.driving && (!status.alive || status.driven || status.owned === 'elsewhere')
    note.textContent = this.driving ? (status.owned === 'elsewhere' ? 'Another device holds the needle.' : 'W pushes in, S pulls out.')
      : !status.alive ? '' : status.driven ? 'Another window drives it.' : status.owned === 'elsewhere' ? 'A device holds it.' : ''
  }
}
