// Measures how old the picture on the screen is, and limits the speed of the needle accordingly. Uses only this page's clock, so that it also works
// when the browser runs on another machine.

import { t } from './words/words.js'

// m by which the needle may be ahead of the picture while pictures arrive regularly; if they stop arriving, the needle moves up to 18 mm further: see
// speedAt
export const FARTHEST = 0.008
export const OLDEST = 2       // s: if the picture is older than this, the needle does not move
export const LATE = 1         // s: if the picture is older than this, the badge says that it is late
const FASTEST = 0.04          // m/s, speed of a driven needle: max_speed in rate_control.c
const KEPT = 200              // number of commands whose sending time is stored
const STATUSES = 0.15         // s, slightly more than the interval of 0.1 s at which trocar-view sends a status

export class PictureAge {
  constructor() {
    this.sent = new Map() // maps the number of each move command to the time (ms) at which it was sent
    this.number = 0
    this.travel = 0       // s, time between sending a command and receiving the status that acknowledges it
    this.picture = null   // the picture on the screen
  }

  /** Returns the sequence number of a move command that is sent at `now` (ms), and records that time. */
  count(now) {
    this.sent.set(++this.number, now)
    this.sent.delete(this.number - KEPT)
    return this.number
  }

  /** Handles a status that arrived at `now` (ms) and names the last command that trocar-view had received when it wrote the status. */
  hear(number, now) {
    if (this.sent.has(number)) this.travel = (now - this.sent.get(number)) / 1000
    for (const older of [...this.sent.keys()]) if (older <= number) this.sent.delete(older)
  }

  /** Handles a picture that arrived at `now` (ms). Its `age` (s), measured by trocar-view's clock since the picture's tick, does not include the time
     in transit. */
  receive(picture, age, now) { picture.came = { now, age: Math.max(age, 0) } }

  /** Must be called when the picture is on the screen, or if it looks the same as the picture on the screen. */
  show(picture) { this.picture = picture }

  /** Returns the age (s) of what the screen shows at `now` (ms), including the round trip of a command to trocar-view. */
  at(now) {
    if (!this.picture?.came) return this.travel
    const unanswered = (now - Math.min(now, ...this.sent.values())) / 1000 - STATUSES
    return Math.max(this.travel, unanswered) + this.picture.came.age + (now - this.picture.came.now) / 1000
  }
}

/** Returns the fraction of full speed that is allowed when the picture has this age (s). If the age is constant, the needle is at most FARTHEST ahead of
 * the picture. If no more pictures arrive, the age grows from 0.2 s to OLDEST, and the needle moves a further FARTHEST ln(OLDEST / 0.2 s). */
export const speedAt = (age) => (age > OLDEST ? 0 : Math.min(1, FARTHEST / (FASTEST * Math.max(age, 1e-3))))

/** Returns the speed limit in words; '' at full speed. */
export function wordsAt(age) {
  const speed = speedAt(age)
  if (speed === 1) return ''
  return speed === 0 ? t('age.still', { age: OLDEST }) : t('age.slow', { age: age.toFixed(1), speed: Math.max(1, Math.round(1000 * speed * FASTEST)) })
}
