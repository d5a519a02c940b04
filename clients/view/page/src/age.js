// Measures how old the picture on the screen is, and limits the speed of the needle accordingly. Uses only this page's clock, so it also works if the
// browser runs on another machine.

import { t } from './words/words.js'

// m by which the needle may be ahead of the picture while pictures arrive regularly. If they stop, it moves up to 18 mm farther: see speedAt
export const FARTHEST = 0.008
export const OLDEST = 2       // s, age of the picture beyond which the needle stops
export const LATE = 1         // s, age of the picture beyond which the badge says that it is late
const FASTEST = 0.04          // m/s, full speed: max_speed in rate_control.c
const KEPT = 200              // how many commands' sending times are kept
const STATUSES = 0.15         // s, a little more than the 0.1 s between two statuses of trocar-view

export class PictureAge {
  constructor() {
    this.sent = new Map() // number of a move command -> when it was sent, ms
    this.number = 0
    this.travel = 0       // s, from sending a command to receiving the status that acknowledges it
    this.picture = null   // the picture on the screen
  }

  /** Returns the number for a move command that is sent at `now` (ms), and records when it was sent. */
  count(now) {
    this.sent.set(++this.number, now)
    this.sent.delete(this.number - KEPT)
    return this.number
  }

  /** Handles a status that arrived at `now` (ms). `number` is the last command that trocar-view had received when it wrote the status. */
  hear(number, now) {
    if (this.sent.has(number)) this.travel = (now - this.sent.get(number)) / 1000
    for (const older of [...this.sent.keys()]) if (older <= number) this.sent.delete(older)
  }

  /** Handles a picture that arrived at `now` (ms). `age` (s) is the time since the picture's tick by trocar-view's clock, not counting the time in transit. */
  receive(picture, age, now) { picture.came = { now, age: Math.max(age, 0) } }

  /** Call it when the picture is on the screen, or when it looks the same as the one on the screen. */
  show(picture) { this.picture = picture }

  /** Returns the age (s) of what the screen shows at `now` (ms), including the round trip of a command to trocar-view. */
  at(now) {
    if (!this.picture?.came) return this.travel
    const unanswered = (now - Math.min(now, ...this.sent.values())) / 1000 - STATUSES
    return Math.max(this.travel, unanswered) + this.picture.came.age + (now - this.picture.came.now) / 1000
  }
}

/** Returns the fraction of full speed to allow when the picture has this age (s). At a constant age, the needle gets at most FARTHEST ahead of the
 * picture. If no more pictures arrive, the age grows from 0.2 s to OLDEST, and meanwhile the needle moves a further FARTHEST ln(OLDEST / 0.2 s). */
export const speedAt = (age) => (age > OLDEST ? 0 : Math.min(1, FARTHEST / (FASTEST * Math.max(age, 1e-3))))

/** Returns the speed limit in words, or '' at full speed. */
export function wordsAt(age) {
  const speed = speedAt(age)
  if (speed === 1) return ''
  return speed === 0 ? t('age.still', { age: OLDEST }) : t('age.slow', { age: age.toFixed(1), speed: Math.max(1, Math.round(1000 * speed * FASTEST)) })
}
