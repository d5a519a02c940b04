// How old the picture on the screen is, and how fast a needle may be driven by it. Measured on this page's clock alone, so that it is right on other machines too.

export const FARTHEST = 0.008 // m that the needle may be ahead of the picture while pictures come evenly; once they stop it moves up to 18 mm further: see speedAt
export const OLDEST = 2       // s: with pictures older than this, the needle does not move
export const LATE = 1         // s: the badge says so
const FASTEST = 0.04          // m/s, of a driven needle: max_speed in rate_control.c
const KEPT = 200              // commands whose time is remembered
const STATUSES = 0.15         // s: trocar-view writes a status each 0.1 s

export class PictureAge {
  constructor() {
    this.sent = new Map() // number of a command to move -> when it was sent, ms
    this.number = 0
    this.travel = 0       // s, from sending a command to the status that acknowledges it
    this.picture = null   // on the screen
  }

  /** The number of a command to move that is sent at `now` (ms). */
  count(now) {
    this.sent.set(++this.number, now)
    this.sent.delete(this.number - KEPT)
    return this.number
  }

  /** A status has come at `now` (ms), which names the last command that trocar-view had heard when it wrote it. */
  hear(number, now) {
    if (this.sent.has(number)) this.travel = (now - this.sent.get(number)) / 1000
    for (const older of [...this.sent.keys()]) if (older <= number) this.sent.delete(older)
  }

  /** A picture has come at `now` (ms), `age` (s) after its tick, on trocar-view's clock without the way here. */
  receive(picture, age, now) { picture.came = { now, age: Math.max(age, 0) } }

  /** The picture is on the screen, or looks the same as the one on the screen. */
  show(picture) { this.picture = picture }

  /** Age (s) of what the screen shows at `now` (ms), including the round trip of a command to trocar-view. */
  at(now) {
    if (!this.picture?.came) return this.travel
    const unanswered = (now - Math.min(now, ...this.sent.values())) / 1000 - STATUSES
    return Math.max(this.travel, unanswered) + this.picture.came.age + (now - this.picture.came.now) / 1000
  }
}

/** Part of the full speed that is allowed by a picture of this age (s): a needle driven by pictures of one age is FARTHEST ahead of what is seen. If no more come, the age
 *  grows from 0.2 s to OLDEST, and the needle goes on by FARTHEST ln(OLDEST / 0.2 s). */
export const speedAt = (age) => (age > OLDEST ? 0 : Math.min(1, FARTHEST / (FASTEST * Math.max(age, 1e-3))))

/** The limit on speed in words; '' at full speed. */
export function wordsAt(age) {
  const speed = speedAt(age)
  if (speed === 1) return ''
  return speed === 0 ? `Picture over ${OLDEST} s old: held still.` : `Picture ${age.toFixed(1)} s old: ${Math.max(1, Math.round(1000 * speed * FASTEST))} mm/s at most.`
}
