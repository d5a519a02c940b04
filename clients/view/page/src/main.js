// Main module of the page: connects received data, displayed time, 3D view, slice, plots and needle control.
import './style.css'
import { LATE, PictureAge } from './age.js'
import { CONTACT, GUIDED, hubColour, rampCss, regionColour, TRACK } from './colours.js'
import { CONTACT_NUMBERS } from './decode.js'
import { actionOf, Drive, leave } from './drive.js'
import { Echo } from './ultrasound_view.js'
import { History } from './history.js'
import { Link } from './link.js'
import { FORCE_SCALE } from './needle.js'
import { arrange, arrangeLike, compose, save, SIZE } from './picture.js'
import { patientText } from './patient.js'
import { Plots, Strip } from './plots.js'
import { Probe } from './panels/probe.js'
import { Scanner } from './panels/scanner.js'
import { Sound } from './sound.js'
import { Procedure } from './procedure/procedure.js'
import { Stage } from './view3d.js'
import { FRESH, showBanner, Silence, stateOf } from './state.js'
import { Task } from './panels/task.js'
import { Tissue } from './panels/tissue.js'
import { hasText, listLanguages, said, t } from './words/words.js'

const STRIP_SPAN = 60 // s, live
const asked = new URLSearchParams(location.search), posing = asked.has('picture') // `posing`: only render one picture and send it back

const element = (id) => document.getElementById(id)
if (!document.createElement('canvas').getContext('webgl2')) {
  element('stage').innerHTML = `<p class="sorry">${t('webgl')}</p>`
  throw new Error('no WebGL 2')
}

const stage = new Stage(element('view')), echo = new Echo(element('echo'), element('echo-marks')), plots = new Plots(element('plots'))
const PLOT_PERIOD = stage.slow ? 200 : 66 // ms between plot updates
const strip = new Strip(element('timeline'), seek)

let scene = null, history = new History(true), status = { now: 0, alive: false }
let shown = null                 // the picture on display
let chosen = 0                   // the needle that readouts, plots and controls refer to
let clock = { following: true, playing: true, time: 0, at: 0 } // `time` is used only while not following the live data
let connected = false, refusal = '', silence = new Silence(), pictureSilence = new Silence(), checked = 0, statusAt = 0
let state = { name: 'unconnected' }
let latency = [], drawing = null, age = new PictureAge(), servers = 0, restarted = 0, plotsDrawn = 0, range = 1e-3

/* ---- received data ---- */

const link = new Link({
  open() { connected = true },
  closed(reason) { connected = false; refusal = reason; status = { ...status, alive: false, drives: false }; showState() },
  received() { refusal = ''; silence.end(); procedure.hearAll() },
  scene: takeScene,
  picture(picture) {
    picture.seeds = procedure.seeds
    age.receive(picture, liveTime() - picture.time, performance.now())
    history.addPicture(picture)
    pictureSilence.end()
    if (clock.following && scene.live) picture.fresh = true
  },
  samples(samples) {
    history.addSamples(samples, scene.membranes)
    if (scene.live && history.count > samples.length) sound.hear(samples) // no sounds for the first samples, which cover the past minute
  },
  seeds(seeds) {
    procedure.hearSeeds(seeds)
    if (!scene.live && history.pictures.length) history.pictures.at(-1).seeds = seeds // in a log, the seeds come after their picture
  },
  reply(reply) { procedure.hearReply(reply) },
  dose(dose) { procedure.hearDose(dose) },
  plan(plan) { procedure.hearPlan(plan) },
  ultrasound(images) { scanner.hear(images) },
  status(received) {
    status = received
    noteServer()
    task.hear(received.task, received.driven && !received.drives)
    tissue.hear(received)
    chooseOfStatus()
    statusAt = performance.now()
    age.hear(status.steered, statusAt)
    silence.end()
    showState()
  },
})

const drive = new Drive(link, age, { lever: element('lever'), pad: element('pad'), roll: element('roll'), tilt: element('tilt'), does: element('pad-does'), take: element('take'), reset: element('reset'), note: element('drive-note'), controls: element('controls') })

const procedure = new Procedure({ stage, echo, drive, link, choose }), probe = new Probe({ stage, echo, procedure, drive, link, setSlice }), task = new Task(link, procedure), tissue = new Tissue(link), sound = new Sound(element('sound')), scanner = new Scanner({ link, slices: [echo, procedure.sagittal], both: () => procedure.active })

function takeScene(received) {
  scene = received
  element('guide-key').hidden = scene.guides.length === 0
  element('place').hidden = !scene.patientToMesh
  history = new History(scene.live, scene.parkingPoses.length)
  listNeedles()
  shown = null
  clock = { following: scene.live, playing: true, time: 0, at: performance.now() }
  plots.budget = 1 / scene.rate
  stage.load(scene)
  echo.load(scene)
  procedure.load(scene)
  task.load(scene)
  probe.load(scene)
  setCut(element('cut-axis').value)
  listLayers()
  document.body.classList.toggle('log', !scene.live)
  plots.resize()
  element('scene-name').textContent = scene.path.split('/').pop()
  element('scene-name').title = scene.path
  setSlice((echo.range.from + echo.range.to) / 2)
  setTheme(document.documentElement.dataset.theme)
}

/** Clears the numbers and seeds that came from a previous server. */
function noteServer() {
  if (!status.server || status.server === servers) return
  if (servers) {
    restarted = history.end
    procedure.hearRestart()
  }
  servers = status.server
}

/** Returns trocar-view's current time (s), extrapolated from the last status. */
function liveTime() { return status.now + (performance.now() - statusAt) / 1000 }

function showState() {
  const now = performance.now(), dt = (now - checked) / 1000
  checked = now
  silence.pass(dt)
  if (status.alive && !status.shown) pictureSilence.end() // the server sends no pictures until a hand first engages a needle
  else pictureSilence.pass(dt)
  if (!scene && !refusal) return // connecting
  const live = scene?.live ?? true
  state = stateOf({ live, link: { connected, refusal, silence: silence.seconds, pictures: pictureSilence.seconds }, status,
                    age: live && history.count ? liveTime() - history.end : Infinity, behind: clock.following ? null : liveTime() - timeShown() })
  document.body.dataset.state = state.name
  const badge = element('link'), seen = age.at(now), late = state.name === 'live' && drive.driving && seen > LATE
  badge.textContent = late ? t('badge.late', { age: seen.toFixed(1) }) : state.badge
  badge.className = `badge ${late ? 'past' : state.kind}`
  showBanner(element('banner'), state)
  drive.show(status, state)
  element('rate').textContent = status.alive ? `${(status.rate / 1000).toPrecision(3)} kHz` : '–'
  showPage()
  element('notice').textContent = element('notice').title = noticeOf(status)
}

/** Shows this page's number in the header and the title if several pages are connected to the same trocar-view. */
function showPage() {
  const several = status.pages > 1, name = scene ? scene.path.split('/').pop() : '', badge = element('page-number')
  badge.hidden = !several
  badge.textContent = several ? t('page', { page: status.page }) : ''
  badge.classList.toggle('driving', several && status.driver === status.page)
  document.title = several || name ? t('title', { page: several ? `${t('title.page', { page: status.page })} ` : '', name }) : 'trocar'
}

function noticeOf({ state: hand, flags = [], scene: served = '', message = '' }) {
  const unheld = ['leaving', 'resting', 'taking'].includes(hand) // nobody sends poses for it, so that is normal
  const words = flags.filter((flag) => flag !== 'ramping' && !(flag === 'stale' && unheld)).map((flag) => (hasText(`flag.${flag}`) ? t(`flag.${flag}`) : flag.replaceAll('_', ' ')))
  // procedure mode itself shows the answers to commands
  if (message && !(procedure.active && /^command \d+ of/.test(message))) words.push(scene?.live ? t('notice.server', { message: said(message) }) : said(message))
  if (served && served.split('/').pop() !== scene.path.split('/').pop()) words.unshift(t('notice.scene', { scene: served }))
  return words.join(' · ')
}

/* ---- time ---- */

function seek(time) {
  clock = { following: false, playing: false, time: Math.min(Math.max(time, history.start), history.end), at: performance.now() }
}

function goLive() { clock = { following: scene?.live ?? true, playing: true, time: scene?.live ? history.end : history.start, at: performance.now() } }

function togglePlay() {
  const now = timeShown(), ended = now >= history.end - 1e-3
  clock = { following: false, playing: !(clock.playing && !(ended && !clock.following)), time: ended && !clock.following && !scene.live ? history.start : now, at: performance.now() }
}

function step(by) {
  const at = history.pictures[history.pictureIndex(timeShown()) + by]
  if (at) seek(at.time)
}

function timeShown() {
  if (clock.following) return Math.max(history.end, history.pictures.at(-1)?.time ?? 0)
  return clock.time
}

function advanceClock(now) {
  if (!clock.following && clock.playing) {
    clock.time += (now - clock.at) / 1000
    if (clock.time >= history.end) {
      if (scene?.live) goLive()
      else Object.assign(clock, { time: history.end, playing: false })
    }
  }
  clock.at = now
}

/* ---- drawing ---- */

function frame(now) {
  requestAnimationFrame(frame)
  if (!scene || posing) return
  advanceClock(now)
  draw(now)
  if (now - plotsDrawn > PLOT_PERIOD) {
    plotsDrawn = now
    showState()
    drawPlots()
    showNumbers()
    procedure.describe(status, state, history, chosen)
  }
}

/** Draws the 3D view only once the GPU has finished the previous frame; queued frames would be outdated by the time they appear. The slices do not wait
 * for this. */
function draw(now) {
  const finished = stage.finished()
  if (finished) noteLatency()
  showPicture()
  procedure.show(shown, clock.following, chosen)
  probe.show(shown)
  scanner.ask(clock.following && scene.live, now)
  const drawn = finished && stage.draw(now, echo.simulated && echo.isRecent)
  echo.draw(stage.coarse)
  procedure.draw(stage.coarse)
  if (!shown?.fresh) return
  if (drawn) drawing = shown
  else if (finished && !stage.dirty) age.show(shown) // the new picture looks the same as the one on the screen
  else return
  shown.fresh = false
}

function showPicture() {
  if (clock.following && status.alive && !status.shown) return showHome()
  if (history.pictures.length === 0) return
  const picture = clock.following ? history.pictures.at(-1) : history.pictures[history.pictureIndex(clock.time)]
  if (picture === shown) return
  const same = shown && looksSame(picture, shown)
  shown = picture
  if (same) return
  const largest = stage.show(picture)
  if (largest > range || largest < range / 3) setRange(largest)
  element('track-key').hidden = stage.tracks.empty
  echo.show(stage.anatomy.place.array, stage.needles.map(({ line }) => line))
  if (element('follow').checked) followTip()
}

/** Clears a previous server's picture and shows the needles at their waiting poses. */
function showHome() {
  if (!shown) return
  shown = null
  stage.showHome()
  element('track-key').hidden = stage.tracks.empty
  echo.show(stage.anatomy.place.array, stage.needles.map(({ line }) => line))
  if (element('follow').checked) followTip()
}

/** True if two pictures look the same, as when needles rest. Tracks are compared as well, because they may arrive later. */
function looksSame(a, b) {
  const equal = (x, y) => x.length === y.length && x.every((value, i) => value === y[i])
  const alike = (x, y) => x === y || Boolean(x && y) && equal(x.joints, y.joints) && equal(x.contacts, y.contacts) && equal(x.orientation, y.orientation)
    && equal(x.tracks.kinds, y.tracks.kinds)
  return a.scale === b.scale && scene.parkingPoses.every((home, i) => alike(a.needles[i], b.needles[i])) && equal(a.displacement, b.displacement)
}

/** Sets the top of the colour scale to one of the values 0.2, 0.5, 1, 2, 5, ... mm. */
function setRange(largest) {
  const wanted = Math.max(largest, 2e-4), decade = 10 ** Math.floor(Math.log10(wanted))
  range = [1, 2, 5, 10].map((k) => k * decade).find((v) => v >= wanted * 0.999)
  stage.setRange(range)
  element('colour-range').textContent = `0 – ${+(1e3 * range).toPrecision(2)} mm`
}

/** Measures the latency from the device's pose to the finished picture, over the last pictures. Only meaningful if all programs run on the same machine. */
function noteLatency() {
  const poseTime = drawing?.needles[chosen]?.poseTime
  if (poseTime) latency.push(performance.timeOrigin + performance.now() - poseTime)
  if (latency.length > 30) latency.shift()
  if (drawing) age.show(drawing)
  drawing = null
}

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1]

function drawPlots() {
  const now = scene.live ? Math.max(liveTime(), history.end) : history.end, time = timeShown(), span = Number(element('window').value)
  const wide = !scene.live, from = wide ? history.start : clock.following ? now - span : Math.max(Math.min(time - span / 2, now - span), history.start)
  plots.show(history, from, wide ? Math.max(history.end, history.start + 0.1) : from + span, clock.following ? null : time)
  const start = scene.live ? now - STRIP_SPAN : history.start
  strip.draw(history, start, scene.live ? now : Math.max(history.end, start + 0.1), time)
  element('clock').textContent = state.name === 'live' ? t('clock.now') : history.count === 0 ? '–' : `${(time - (scene.live ? now : 0)).toFixed(2)} s`
  for (const [name, value] of [['min', start], ['max', scene.live ? now : history.end], ['now', time]]) element('timeline').setAttribute(`aria-value${name}`, value.toFixed(2))
  element('timeline').setAttribute('aria-valuetext', element('clock').textContent)
  element('play').textContent = t(clock.playing ? 'play.pause' : 'play.play')
  element('live').disabled = clock.following
}

function showNumbers() {
  showScale()
  if (history.count === 0) return
  const rests = clock.following && status.state === 'resting' // no hand feels the force on a resting needle. `gone`: the newest sample is from an
                                                              // earlier server or too old, for example because the needle was left at rest
  const newest = history.count - 1, gone = history.end <= restarted || scene.live && status.alive && liveTime() - history.end > FRESH
  const at = rests || clock.following && gone ? -1 : clock.following ? newest : history.sampleNear(timeShown()), value = (column) => history.columns[column][at]
  element('depth').textContent = at < 0 ? '–' : `${(1e3 * value(7)).toFixed(1)} mm`
  element('force').textContent = at < 0 ? '–' : `${Math.hypot(value(1), value(2), value(3)).toFixed(2)} N`
  const tip = stage.needles[chosen].tip
  if (scene.patientToMesh) element('tip').textContent = at < 0 && !rests || !tip ? '–' : patientText(scene.patientToMesh, tip.toArray())
  element('contacts').textContent = shown?.needles[chosen] ? `${shown.needles[chosen].contacts.length / CONTACT_NUMBERS}` : '–'
  element('lag').textContent = shown?.needles[chosen] ? `${Math.round(-180 / Math.PI * shown.needles[chosen].tipLead) + 0}°` : '–'
  element('tick').textContent = status.alive && at >= 0 ? `${(1e6 * value(10)).toFixed(0)} µs` : '–'
  element('latency').textContent = status.alive && latency.length ? `${median(latency).toFixed(0)} ms` : '–'
}

/** Shows a scale bar of about 100 pixels whose length is a round number. */
function showScale() {
  const most = 110 * stage.metresPerPixel(), decade = 10 ** Math.floor(Math.log10(most)), length = [5, 2, 1].map((k) => k * decade).find((v) => v <= most)
  element('scale-bar').style.width = `${length / stage.metresPerPixel()}px`
  element('scale-text').textContent = t('scale', { length: +(1e3 * length).toPrecision(2), force: +(length / FORCE_SCALE).toPrecision(3) })
}

/* ---- slices and layers ---- */

function setSlice(z) {
  const { from, to } = echo.range
  echo.setPlace(z)
  element('slice').value = (z - from) / (to - from)
  stage.slice.move(z)
  stage.dirty = true
}

/** Moves the slice to the tip or, while the tip is outside the tissue, to the middle of the mesh. */
function followTip() {
  const tip = stage.needles[chosen].tip, { from, to } = echo.range
  setSlice(tip?.z > from ? Math.min(tip.z, to) : (from + to) / 2)
}

stage.onSlice = () => { element('follow').checked = false; setSlice(stage.slice.place) }
stage.onCut = (part) => { element('cut-place').value = part }

const OFF_AT_FIRST = ['slice frame']

function listLayers() {
  const list = element('layer-list'), names = ['body', 'mesh', ...new Set([...stage.anatomy.layers.keys()].filter((name) => !['body', 'mesh', 'cut'].includes(name))), 'needle', ...(scene.guides.length ? ['guides'] : []), 'tracks', 'contacts', 'forces', 'slice frame']
  list.replaceChildren(...names.map((name) => {
    const label = document.createElement('label'), box = document.createElement('input'), swatch = document.createElement('i')
    const index = scene.regions.findIndex((region) => region.name === name)
    if (index >= 0) swatch.style.background = regionColour(scene.regions[index], index)
    Object.assign(box, { type: 'checkbox', checked: !OFF_AT_FIRST.includes(name), name })
    box.addEventListener('change', () => stage.setLayer(name, box.checked))
    stage.setLayer(name, box.checked)
    label.append(box, hasText(`layer.${name}`) ? t(`layer.${name}`) : name, swatch)
    return label
  }))
}

function setCut(axis, part = Number(element('cut-place').value)) {
  element('cut-axis').value = axis
  element('cut-place').disabled = !axis
  stage.setCut(axis, part)
}

/* ---- several needles ---- */

/** Fills the menu of needles, which is hidden if the scene has only one. */
function listNeedles() {
  const chooser = element('needle')
  chooser.replaceChildren(...scene.parkingPoses.map((home, i) => new Option(t('needle.number', { needle: i }), i)))
  element('needle-choice').hidden = scene.parkingPoses.length === 1
  choose(0)
}

function choose(needle) {
  chosen = history.needle = drive.needle = needle
  element('needle').value = needle
  element('needle-choice').querySelector('i').style.background = hubColour(needle)
  latency = []
  if (status.needles) status = { ...status, ...status.needles[needle] }
  if (shown && element('follow').checked) followTip()
}

/** Merges the chosen needle's status into `status`. A needle that this page drives is always the chosen one. */
function chooseOfStatus() {
  if (status.drives && status.needle !== chosen) choose(status.needle)
  status = { ...status, ...status.needles?.[chosen] }
  element('needle').disabled = Boolean(status.drives)
}

/* ---- controls ---- */

function setTheme(theme) {
  document.documentElement.dataset.theme = theme
  element('theme').textContent = t(theme === 'light' ? 'theme.dark' : 'theme.light')
  try { localStorage.setItem('theme', theme) } catch { /* a private window has no storage */ }
  if (scene) stage.setTheme(theme !== 'light')
  plots.restyle()
}

const toggleTheme = () => setTheme(document.documentElement.dataset.theme === 'light' ? 'dark' : 'light')
const takePicture = (plan) => compose(plan, { stage, echo, shown: shown?.needles[chosen], history, time: shown?.time ?? 0, range, label: scene.parkingPoses.length > 1 ? `${chosen}` : '' })
const savePicture = async () => save(await takePicture(arrangeLike(element('stage'))), `trocar-${(shown?.time ?? 0).toFixed(2)}s.png`)
const nextCut = () => { const axes = ['', 'x', 'y', 'z']; setCut(axes[(axes.indexOf(element('cut-axis').value) + 1) % axes.length]) }
function showHelp() {
  element('keys').showModal()
  element('keys').scrollTop = 0 // a dialog keeps its scroll position
}
const toggleLayer = (name) => element('layer-list').querySelector(`input[name="${name}"]`)?.click()

const TURN = 0.1, PAN = 0.03, NEARER = 1.1 // rad, fraction of the view's height, and factor of distance, for each press of a key that moves the view
const turnOrPan = (x, y) => ({ shiftKey }) => (shiftKey ? stage.pan(PAN * x, -PAN * y) : stage.orbit(TURN * x, TURN * y, 1))
const ACTIONS = { Space: togglePlay, Comma: () => step(-1), Period: () => step(1), Home: goLive, KeyC: nextCut, KeyM: () => toggleLayer('mesh'), KeyN: toggleTheme, KeyO: () => sound.toggle(), KeyP: savePicture,
                  KeyT: () => drive.toggle(), KeyV: () => tissue.open(), Digit1: () => stage.look(1), Digit2: () => stage.look(2), Digit3: () => stage.look(3), Digit4: () => stage.look(4),
                  Digit5: turnOrPan(-1, 0), Digit6: turnOrPan(1, 0), Digit7: turnOrPan(0, -1), Digit8: turnOrPan(0, 1),
                  Digit9: () => stage.orbit(0, 0, 1 / NEARER), Digit0: () => stage.orbit(0, 0, NEARER),
                  ArrowLeft: () => step(-1), ArrowRight: () => step(1) } // only if these keys do not move the needle

const STEPS = ['Comma', 'Period', 'ArrowLeft', 'ArrowRight', 'Digit5', 'Digit6', 'Digit7', 'Digit8', 'Digit9', 'Digit0'] // keys that repeat while held down

addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || element('keys').open || element('task').open || element('tissue').open || event.target.matches('input[type=text]')
      || event.target.matches('select, input[type=range]') && event.code.startsWith('Arrow')) return
  const action = ACTIONS[actionOf(event)]
  if (event.target === element('timeline') && event.code.startsWith('Arrow')) { event.preventDefault(); if (action) action(event) }
  else if (event.key === '?') showHelp()
  else if (drive.key(event, true)) event.preventDefault()
  else if (probe.key(event) || procedure.key(event)) event.preventDefault()
  else if (action && scene && (!event.repeat || STEPS.includes(event.code)) && !(event.code === 'Space' && event.target.matches('button, input, summary'))) { event.preventDefault(); action(event) }
})
addEventListener('keyup', (event) => drive.key(event, false))

element('screenshot').addEventListener('click', savePicture)
element('theme').addEventListener('click', toggleTheme)
element('help').addEventListener('click', showHelp)
element('play').addEventListener('click', togglePlay)
element('live').addEventListener('click', goLive)
element('needle').addEventListener('change', (event) => choose(Number(event.target.value)))
element('take').addEventListener('click', (event) => { if (event.detail < 2) drive.toggle(); leave(event) }) // ignore the second click of a double click
element('banner').querySelector('button').addEventListener('click', goLive)
element('cut-axis').addEventListener('change', (event) => setCut(event.target.value))
element('cut-place').addEventListener('input', (event) => setCut(element('cut-axis').value, Number(event.target.value)))
element('slice').addEventListener('input', (event) => { element('follow').checked = false; setSlice(echo.range.from + event.target.value * (echo.range.to - echo.range.from)) })
new ResizeObserver(() => { stage.resize(); if (scene) stage.dirty = true }).observe(element('view'))
new ResizeObserver(() => echo.resize()).observe(element('trus'))
procedure.onSeed = () => sound.play('seed')
listLanguages(element('language'))
element('mode').addEventListener('click', () => { procedure.toggle(); plots.resize() })

document.body.classList.toggle('software', stage.slow)
element('colours').style.background = rampCss
for (const [name, key] of [['stick', 0], ['forward', 1], ['backward', -1]]) document.querySelector(`.dot.${name}`).style.background = CONTACT[key]
for (const [name, tint] of [['guide', GUIDED], ['track', TRACK]]) document.querySelector(`.dot.${name}`).style.background = tint
let remembered = null
try { remembered = localStorage.getItem('theme') } catch { /* a private window has no storage */ }
setTheme(remembered ?? (matchMedia('(prefers-color-scheme: light)').matches ? 'light' : 'dark'))
const small = matchMedia('(max-width: 860px), (max-height: 560px)'), foldLayers = () => { element('layers').open = !small.matches && !procedure.active }
small.addEventListener('change', foldLayers)
foldLayers()
requestAnimationFrame(frame)

/* ---- for trocar-view --png, and for tests ---- */

/** Applies the options of trocar-view --png. `cut` is the axis of the cut and `place` its position on that axis in metres; without `place`, the cut is
 * at the tip if that is in the tissue. */
async function pose() {
  const number = (name, otherwise) => Number(asked.get(name) ?? otherwise), plan = arrange({ width: number('width', SIZE.width), height: number('height', SIZE.height) })
  setTheme(asked.get('theme') ?? 'light')
  stage.setSize(plan.stage.width, plan.stage.height)
  stage.look(number('view', 1))
  seek(history.end)
  showPicture()
  procedure.show(shown, false, chosen)
  const axis = asked.get('cut') ?? '', from = stage.box.min[axis], to = stage.box.max[axis], part = (number('place', stage.needles[chosen].tip[axis]) - from) / (to - from)
  setCut(axis, part > 0 && part < 1 ? part : 0.5)
  link.sendPicture(await (await takePicture(plan)).arrayBuffer())
}

if (posing) {
  const wait = setInterval(() => {
    if (history.pictures.length === 0) return
    clearInterval(wait)
    pose()
  }, 50)
}
window.trocar = { stage, age, sound, echo, plots, drive, probe, scanner, task, tissue, seek, goLive, setCut, setTheme, choose, procedure, get chosen() { return chosen }, get history() { return history }, get status() { return status }, get state() { return state }, get shown() { return shown }, get latency() { return latency } }
