// Plots of force, torque, depth and timing, with markers at events; and the timeline strip.
import uPlot from 'uplot'
import 'uplot/dist/uPlot.min.css'
import { AXES, TIMING } from './colours.js'
import { GAP } from './history.js'
import { t } from './words/words.js'

const SLOT = 0.01 // s, between samples
const CLOSE = 90 // px; in a lower plot, the labels of all decades would touch
const MICRO = 1e6, MILLI = 1e3
const PLOTS = [
  { title: t('plot.force'), unit: 'N', columns: [1, 2, 3], names: ['x', 'y', 'z'], colours: AXES, scale: 1, least: 0.2 },
  { title: t('plot.torque'), unit: 'mN m', columns: [4, 5, 6], names: ['x', 'y', 'z'], colours: AXES, scale: MILLI, least: 5 },
  { title: t('plot.depth'), unit: 'mm', columns: [7], names: [t('plot.series.depth')], colours: ['#37d0ff'], scale: MILLI, least: 5, fromZero: true },
  { title: t('plot.timing'), unit: 'µs', live: true, columns: [10, 11, 8, 9], names: [t('plot.series.tick'), t('plot.series.tickMax'), t('plot.series.late'), t('plot.series.lateMax')], colours: [TIMING[0], TIMING[0], TIMING[1], TIMING[1]],
    dashes: [[], [3, 3], [], [3, 3]], scale: MICRO, logarithmic: true },
]

/** Formats a number, never as negative zero. */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, '$1')

/** Tells uPlot which pixel ranges have no data, so that it draws no line there. */
function gaps(u, series, first, last, missing) {
  const times = u.data[0]
  for (let i = Math.max(first, 1); i <= last; i++)
    if (times[i] - times[i - 1] > GAP) missing.push([u.valToPos(times[i - 1], 'x', true), u.valToPos(times[i], 'x', true)])
  return missing
}

export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim()

export class Plots {
  constructor(container) {
    this.container = container
    this.history = null
    this.budget = 1e-3 // s
    this.time = null   // s, time of the picture on display; null at the end
    this.plots = []
    this.plots = PLOTS.map((plot) => this.build(plot))
    new ResizeObserver(() => this.resize()).observe(container)
  }

  build(plot) {
    const axis = { stroke: () => css('--muted'), grid: { stroke: () => css('--grid'), width: 1 }, ticks: { show: false }, font: '10px system-ui, sans-serif' }
    const number = (value) => (value === null || value === undefined ? '–' : fixed(plot.scale * value, plot.scale === 1 ? 2 : plot.logarithmic ? 0 : 1))
    const isDecade = (v, every) => Math.abs(Math.log10(v) / every - Math.round(Math.log10(v) / every)) < 1e-6
    // in a low plot, label only every second decade
    const decades = (u, splits) => splits.map((v) => (isDecade(v, u.bbox.height / devicePixelRatio < CLOSE ? 2 : 1) ? v : null))
    const holder = document.createElement('div')
    if (plot.live) holder.className = 'live-only'
    const head = document.createElement('header')
    head.innerHTML = `<h2>${plot.title} <small>${plot.unit}</small></h2>`
    holder.append(head)
    this.container.append(holder)
    const options = {
      width: 320, height: 110, legend: { live: true, mount: (u, legend) => head.append(legend) }, cursor: { sync: { key: 'time' }, drag: { x: false, y: false }, points: { size: 5 } },
      padding: [7, 8, 6, 0],
      scales: { x: { time: false }, y: plot.logarithmic ? { distr: 3, range: (u, low, high) => [1e-6, Math.max(2 * this.budget, high * 1.2)] } : { range: (u, low, high) => this.range(plot, low, high) } },
      axes: [
        { ...axis, size: 21, gap: 6, values: (u, values) => values.map((v) => v.toFixed(values[1] - values[0] < 1 ? 1 : 0)) },
        { ...axis, size: 40, gap: 3, values: (u, values) => values.map((v) => (v === null ? null : `${+(plot.scale * v).toPrecision(3)}`)), ...(plot.logarithmic ? { filter: decades, grid: { ...axis.grid, filter: decades } } : { space: 22 }) },
      ],
      series: [{ label: 's', value: (u, v) => (v === null || v === undefined ? '–' : v.toFixed(2)) },
               ...plot.columns.map((column, i) => ({ label: plot.names[i], stroke: plot.colours[i], width: 1.4, dash: plot.dashes?.[i], gaps, points: { show: false }, value: (u, v) => number(v) }))],
      hooks: { draw: [(u) => this.drawMarks(u, plot)] },
    }
    const built = { ...plot, holder, head, chart: new uPlot(options, [[], ...plot.columns.map(() => [])], holder) }
    new ResizeObserver(() => this.resize()).observe(head)
    built.chart.ctx.canvas.setAttribute('role', 'img')
    built.chart.ctx.canvas.setAttribute('aria-label', t('plot.label', { plot: plot.title }))
    return built
  }

  range(plot, low, high) {
    const margin = 0.08 * Math.max(high - low, plot.least / plot.scale)
    if (!Number.isFinite(low)) return [-plot.least / plot.scale, plot.least / plot.scale]
    return [plot.fromZero ? 0 : Math.min(low - margin, -plot.least / plot.scale), Math.max(high + margin, plot.least / plot.scale)]
  }

  /** Divides the available height among the plots. The last visible one has the time axis. */
  resize() {
    const shown = this.plots.filter(({ holder }) => holder.clientHeight > 0), last = shown.at(-1)
    for (const plot of shown) plot.holder.classList.toggle('last', plot === last)
    for (const plot of shown) {
      plot.chart.axes[0].show = plot === last
      plot.chart.setSize({ width: plot.holder.clientWidth, height: plot.holder.clientHeight - plot.head.offsetHeight })
    }
  }

  /** Shows the interval from `from` to `to` (s). `time` is that of the picture on display, or null at the end. */
  show(history, from, to, time) {
    this.history = history
    this.time = time
    if (history.count === 0) return
    const columns = history.slice(from, to)
    const near = history.sampleNear(time ?? to), at = near < 0 ? null : near - Math.max(history.sampleIndex(from), 0)
    for (const plot of this.plots) {
      const data = [columns[0], ...plot.columns.map((column) => (plot.logarithmic ? columns[column].map((v) => Math.max(v, 1e-6)) : columns[column]))]
      plot.chart.batch(() => {
        plot.chart.setData(data, false)
        plot.chart.setScale('x', { min: from, max: to })
      })
      if (plot.chart.cursor.left < 0) plot.chart.setLegend({ idx: at })
    }
  }

  drawMarks(u, plot) {
    if (!this.history) return
    const ink = u.ctx, { left, top, width, height } = u.bbox, ratio = devicePixelRatio
    ink.save()
    ink.beginPath()
    ink.rect(left, top, width, height)
    ink.clip()
    ink.textAlign = 'left'
    let free = left // where the space for the next label begins
    for (const mark of this.history.marks) {
      if (mark.until < u.scales.x.min || mark.time > u.scales.x.max) continue
      const x = u.valToPos(mark.time, 'x', true)
      ink.fillStyle = ink.strokeStyle = mark.event.alarm ? css('--alarm') : css('--event')
      if (mark.event.quiet) { ink.globalAlpha = 0.6; ink.fillRect(x - 0.5 * ratio, top + height - 4 * ratio, ratio, 4 * ratio); ink.globalAlpha = 1; continue }
      if (mark.until > mark.time) { ink.globalAlpha = 0.18; ink.fillRect(x, top, u.valToPos(mark.until, 'x', true) - x, height); ink.globalAlpha = 1 }
      this.line(ink, x, top, x, top + height, [2 * ratio, 3 * ratio], ratio)
      if (plot === PLOTS[0]) {
        ink.font = `${10 * ratio}px system-ui, sans-serif`
        // near the right edge, put the label to the left of its line
        const room = ink.measureText(mark.name).width + 5 * ratio, start = x + room > left + width ? x - room : x + 3 * ratio
        if (start < free) continue
        this.label(ink, mark.name, start, top + 10 * ratio, ratio)
        free = start + room
      }
    }
    if (plot.logarithmic) {
      const y = u.valToPos(this.budget, 'y', true)
      ink.strokeStyle = ink.fillStyle = css('--alarm')
      this.line(ink, left, y, left + width, y, [], ratio)
      ink.font = `${9 * ratio}px system-ui, sans-serif`
      this.label(ink, t('plot.budget'), left + 4 * ratio, y + (y - top < 14 * ratio ? 10 : -3) * ratio, ratio)
    }
    if (this.time !== null) {
      const x = u.valToPos(this.time, 'x', true)
      ink.strokeStyle = css('--accent')
      this.line(ink, x, top, x, top + height, [], 1.5 * ratio)
    }
    ink.restore()
  }

  /** Draws text on a background, so that it is readable over curves. */
  label(ink, text, x, y, ratio) {
    ink.save()
    ink.strokeStyle = css('--panel')
    ink.lineWidth = 3 * ratio
    ink.lineJoin = 'round'
    ink.setLineDash([])
    ink.strokeText(text, x, y)
    ink.fillText(text, x, y)
    ink.restore()
  }

  line(ink, x0, y0, x1, y1, dash, width) {
    ink.setLineDash(dash)
    ink.lineWidth = width
    ink.beginPath()
    ink.moveTo(x0, y0)
    ink.lineTo(x1, y1)
    ink.stroke()
    ink.setLineDash([])
  }

  restyle() { for (const { chart } of this.plots) chart.redraw() }
}

/** Overview of the last minute or the whole log: depth as a filled curve, marks, and the time of the picture on display. */
export class Strip {
  constructor(canvas, onSeek) {
    this.canvas = canvas
    const seek = (event) => {
      const box = canvas.getBoundingClientRect()
      onSeek(this.from + (this.to - this.from) * Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1))
    }
    canvas.addEventListener('pointerdown', (event) => { canvas.setPointerCapture(event.pointerId); this.held = true; seek(event) })
    canvas.addEventListener('pointermove', (event) => { if (this.held) seek(event) })
    canvas.addEventListener('pointerup', () => { this.held = false })
    this.from = 0
    this.to = 1
  }

  draw(history, from, to, time) {
    Object.assign(this, { from, to })
    const ratio = devicePixelRatio, width = this.canvas.clientWidth * ratio, height = this.canvas.clientHeight * ratio
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height })
    const ink = this.canvas.getContext('2d'), at = (t) => width * (t - from) / (to - from)
    ink.clearRect(0, 0, width, height)
    if (history.count > 0) this.drawHill(ink, history, from, to, width, height)
    for (const mark of history.marks) {
      if (mark.event.quiet) continue
      ink.fillStyle = mark.event.alarm ? css('--alarm') : css('--event')
      ink.fillRect(at(mark.time), 0, Math.max(1.5 * ratio, at(mark.until) - at(mark.time)), height)
    }
    ink.fillStyle = css('--accent')
    ink.fillRect(Math.min(at(time), width - 2 * ratio) - ratio, 0, 2 * ratio, height)
  }

  drawHill(ink, history, from, to, width, height) {
    const [times, , , , , , , depth] = history.slice(from, to), step = Math.max(1, Math.floor(times.length / 600))
    let deepest = 0.02
    for (let i = 0; i < depth.length; i += step) deepest = Math.max(deepest, depth[i])
    ink.fillStyle = css('--hill')
    ink.beginPath()
    const x = (i) => width * (times[i] - from) / (to - from)
    ink.moveTo(x(0), height)
    for (let i = 0, last = 0; i < times.length; last = i, i += step) {
      if (times[i] - times[last] > GAP + step * SLOT) { ink.lineTo(x(last), height); ink.lineTo(x(i), height) }
      ink.lineTo(x(i), height * (1 - 0.9 * depth[i] / deepest))
    }
    ink.lineTo(x(times.length - 1), height)
    ink.fill()
  }
}
