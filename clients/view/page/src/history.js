// Stores the received data, with separate samples for each needle: the last minute from a live server, or everything that trocar-view sends from a
// log. The total size is limited.
import { t } from './words/words.js'

const SPAN = 60 // s, live
const PICTURE_BYTES = 256e6 // limit for live pictures; for a log, trocar-view applies the same limit
export const GAP = 0.1 // s; a longer time between two samples (normally 10 ms) is shown as a gap
const COLUMNS = 12 // time, force (3), torque (3), depth, p99 and maximum of lateness and of compute time

/** The samples and events of one needle. */
class Track {
  constructor() {
    this.room = 16384
    this.columns = Array.from({ length: COLUMNS }, () => new Float64Array(this.room))
    this.count = 0
    this.marks = []
  }
}

export const PUNCTURE = 1 << 1

/** Bits of insertion_event in core/insertion/state/tick_data.h. An event marked `quiet` is drawn small and without a label. */
export const EVENTS = [
  { bit: 1 << 0, name: t('event.touched'), quiet: true }, { bit: PUNCTURE, name: t('event.puncture') }, { bit: 1 << 2, name: t('event.contactAdded'), quiet: true },
  { bit: 1 << 3, name: t('event.contactRemoved'), quiet: true }, { bit: 1 << 4, name: t('event.exit') }, { bit: 1 << 5, name: t('event.reentry') },
  { bit: 1 << 6, name: t('event.withdrawn') }, { bit: 1 << 7, name: t('event.lateWorker'), alarm: true }, { bit: 1 << 8, name: t('event.noRoom'), alarm: true },
  { bit: 1 << 9, name: t('event.startsOver'), alarm: true }, { bit: 1 << 10, name: t('event.nodeKept'), quiet: true },
  { bit: 1 << 11, name: t('event.guideMissed'), alarm: true }, { bit: 1 << 12, name: t('event.outside'), alarm: true },
  { bit: 1 << 13, name: t('event.trackDropped'), alarm: true },
]

export class History {
  constructor(live, needles = 1) {
    this.live = live
    this.tracks = Array.from({ length: needles }, () => new Track())
    this.needle = 0 // the needle that is plotted
    this.pictures = []
    this.bytes = 0
  }

  get columns() { return this.tracks[this.needle].columns }
  get count() { return this.tracks[this.needle].count }
  get marks() { return this.tracks[this.needle].marks }
  get start() { return this.count ? this.columns[0][0] : 0 }
  get end() { return this.count ? this.columns[0][this.count - 1] : 0 }

  addSamples(samples, membranes) {
    for (const s of samples) {
      const track = this.tracks[s.needle ?? 0]
      if (!track) continue
      if (track.count === track.room) this.makeRoom(track)
      track.columns[0][track.count] = s.time
      s.values.forEach((value, i) => { track.columns[i + 1][track.count] = value })
      track.count++
      this.addMarks(track, s, membranes)
    }
    if (this.live) this.forget(this.end - SPAN)
  }

  /** Makes room for more data: live data lose their older half, a log's arrays grow. */
  makeRoom(track) {
    const columns = track.columns
    const keep = this.live ? track.room >> 1 : track.count
    if (!this.live) track.room *= 2
    track.columns = columns.map((column) => {
      const moved = this.live ? column : new Float64Array(track.room)
      moved.set(column.subarray(track.count - keep, track.count))
      return moved
    })
    track.count = keep
  }

  addMarks({ marks }, sample, membranes) {
    for (const event of EVENTS) {
      if (!(sample.events & event.bit)) continue
      const name = event.bit === PUNCTURE ? membranes[sample.membrane]?.name ?? event.name : event.name
      const last = marks.findLast((mark) => mark.event === event)
      if (event.alarm && last && sample.time - last.until < 0.5) last.until = sample.time // continues
      else marks.push({ time: sample.time, until: sample.time, event, name })
    }
  }

  addPicture(picture) {
    this.pictures.push(picture)
    this.bytes += picture.bytes
    let spare = 0
    while (this.live && this.bytes > PICTURE_BYTES && spare < this.pictures.length - 2) this.bytes -= this.pictures[spare++].bytes
    if (spare) this.pictures.splice(0, spare)
  }

  forget(before) {
    let old = 0
    while (old < this.pictures.length - 1 && this.pictures[old].time < before) this.bytes -= this.pictures[old++].bytes
    if (old) this.pictures.splice(0, old)
    for (const track of this.tracks)
      if (track.marks[0]?.time < before) track.marks = track.marks.filter((mark) => mark.until >= before) // the first mark may extend into the kept time
  }

  /** Returns the index of the newest picture at or before `time`, or 0 if there is none. */
  pictureIndex(time) {
    let low = 0, high = this.pictures.length - 1
    while (low < high) {
      const middle = (low + high + 1) >> 1
      if (this.pictures[middle].time <= time + 1e-6) low = middle
      else high = middle - 1
    }
    return low
  }

  sampleIndex(time) {
    let low = 0, high = this.count
    while (low < high) {
      const middle = (low + high) >> 1
      if (this.columns[0][middle] < time) low = middle + 1
      else high = middle
    }
    return Math.min(low, this.count - 1)
  }

  /** Returns the index of the sample at `time`, or -1 before the first sample and in gaps. */
  sampleNear(time) {
    const after = this.sampleIndex(time), near = (i) => i >= 0 && Math.abs(this.columns[0][i] - time) <= GAP
    return near(after) ? after : near(after - 1) ? after - 1 : -1
  }

  /** Returns the columns between two times, without copying them. */
  slice(from, to) {
    const a = this.sampleIndex(from), b = this.sampleIndex(to) + 1
    return this.columns.map((column) => column.subarray(Math.max(a, 0), b))
  }
}
