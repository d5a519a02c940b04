// Short sounds for punctures and seeds, made with Web Audio. They are off until the user turns them on, which also lets the browser play them.
import { PUNCTURE } from './history.js'

const SOUNDS = { puncture: { wave: 'triangle', from: 520, to: 170, seconds: 0.09 }, seed: { wave: 'sine', from: 880, to: 1320, seconds: 0.16 } } // Hz
const GAIN = 0.25
const SILENT = 1e-4 // an exponential ramp cannot end at 0

export class Sound {
  /** `box`: check box that turns the sounds on. */
  constructor(box) {
    Object.assign(this, { box, context: null, played: { puncture: 0, seed: 0 } })
    try { box.checked = localStorage.getItem('sound') === 'on' } catch { /* a private window has no storage */ }
    box.addEventListener('change', () => this.keep())
  }

  keep() {
    try { localStorage.setItem('sound', this.box.checked ? 'on' : 'off') } catch { /* a private window has no storage */ }
    if (this.box.checked) this.play('puncture')
  }

  toggle() {
    this.box.checked = !this.box.checked
    this.keep()
  }

  /** Called with live samples. */
  hear(samples) {
    if (samples.some(({ events }) => events & PUNCTURE)) this.play('puncture')
  }

  play(name) {
    if (!this.box.checked) return
    this.context ??= new AudioContext()
    this.context.resume().catch(() => {}) // the browser allows sound only after the user has interacted with the page
    const { wave, from, to, seconds } = SOUNDS[name], { context } = this, start = context.currentTime, tone = context.createOscillator(), volume = context.createGain()
    tone.type = wave
    tone.frequency.setValueAtTime(from, start)
    tone.frequency.exponentialRampToValueAtTime(to, start + seconds)
    volume.gain.setValueAtTime(GAIN, start)
    volume.gain.exponentialRampToValueAtTime(SILENT, start + seconds)
    tone.connect(volume).connect(context.destination)
    tone.start(start)
    tone.stop(start + seconds)
    this.played[name]++
  }
}
