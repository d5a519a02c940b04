// Procedure mode, for a live scene with a template: axial and sagittal images with the template's holes, seeds, plan and dose, and instructions for
// the next step.
import * as THREE from 'three'
import { LATE } from '../age.js'
import { actionOf, leave, TOUCH } from '../drive.js'
import { AXIAL, Echo, SAGITTAL } from '../ultrasound_view.js'
import { describeDose, shadeSlices } from './dose.js'
import { MaterialPoint, organOf, tetAt } from './material.js'
import { Seeds3D } from './seeds3d.js'
import { SliceMarks } from './slice_marks.js'
import { Template } from './template.js'
import { hasText, said, t } from '../words/words.js'

const ORGANS = /prostate|gland|urethra/i // organs on which to centre the images; the rectal wall is then visible below them
const TARGET = /prostate|gland/i // organs in which seeds belong
const ASK_AGAIN = 500 // ms to wait for trocar-view to acknowledge a hole before sending it again
const PUSH = t(TOUCH ? 'push.touch' : 'push'), PULL = t(TOUCH ? 'pull.touch' : 'pull')
const IN_LINE = 5e-4 // m, farthest that the tip may be from the hole's axis for the needle to count as aligned with it
const AT_TARGET = 1e-3 // m
const STEP = 1e-3 // m by which a key moves the target
const THROUGH = 0.01 // m; if at least this much of the needle is inside, but the tip is outside the tissue, it has come out on the far side
const NONE = { pending: [], seeds: [] }
const ALONG = new THREE.Vector3(0, 0, 1) // direction of a needle in a scene without a template
const STRAND = 16 // most seeds in a strand

const element = (id) => document.getElementById(id)
const mm = (length) => (1e3 * length).toFixed(1)
const set = (node, text) => { if (node.textContent !== text) node.textContent = text }

/** Returns what this browser tab has stored for a scene: the chosen hole, the target's position [x, y, z] (m) in the undeformed tissue, and whether the
 * target belongs to the plan. */
function remembered(path) {
  try { return JSON.parse(sessionStorage.getItem(`procedure ${path}`)) ?? {} } catch { return {} } // some private windows have no storage
}

function remember(path, choice) {
  try { sessionStorage.setItem(`procedure ${path}`, JSON.stringify(choice)) } catch { /* storage is not available */ }
}

export class Procedure {
  constructor({ stage, echo, drive, link, choose }) {
    Object.assign(this, { stage, echo, drive, link, chooseNeedle: choose, available: false, active: false, seeds: NONE, plan: [], states: [] })
    this.sagittal = new Echo(element('sagittal-echo'), element('sagittal-marks'), SAGITTAL)
    drive.limit = () => (this.active && (this.waits || this.isThrough) ? 0 : 1)
    drive.letGo = () => (this.active && drive.lies ? this.leave() : link.release())
    this.reset()
    this.onSeed = () => {} // called when a seed has been left in the tissue
    for (const slice of [echo, this.sagittal]) new SliceMarks(this, slice)
    this.addControls()
  }

  reset() {
    Object.assign(this, { hole: null, hovered: null, target: null, planned: false, asked: null, waits: false, isThrough: false, tipTet: -1, answered: undefined, dropped: null, left: null, dose: null, seedsNow: [], plannedNow: [], plan: [], seedless: false, judged: false, shown: null })
  }

  load(scene) {
    const index = scene.live ? scene.guides.findIndex(({ columns, rows }) => columns * rows > 1) : -1
    const before = remembered(scene.path) // if present, the page was disconnected or reloaded
    this.reset()
    this.seeds = NONE
    this.scene = scene
    this.available = index >= 0
    this.connecting = true
    element('mode').hidden = !this.available
    for (const row of document.querySelectorAll('.implant-key')) row.hidden = !this.available
    this.models = new Seeds3D(scene.seedLength)
    this.stage.content.add(this.models.group)
    if (this.available) {
      this.template = new Template(scene.guides[index], index)
      for (const slice of [this.echo, this.sagittal]) {
        slice.focus = (region) => ORGANS.test(region.organ)
        slice.load(scene)
      }
      this.echo.include(this.template.corners().map((point) => [point.x, point.y]))
      this.showTemplate()
      element('needle-buttons').hidden = scene.parkingPoses.length === 1
      this.sagittal.setPlace(this.echo.view.x)
      element('dose').innerHTML = describeDose(null)
    }
    this.setActive(this.available)
    if (before.hole && this.available) this.restore(before)
  }

  /** Restores the hole, and puts the target back where it had been moved to. */
  restore({ hole, target, planned }) {
    if (!(hole.column < this.template.columns && hole.row < this.template.rows && target)) return
    this.hole = hole
    element('hole').value = this.template.name(hole)
    this.planned = planned
    this.setTarget(new THREE.Vector3(...target))
  }

  /** Moves the sagittal view so that it shows the template as well as the organs. */
  showTemplate() {
    const { probe, spread, view } = this.sagittal, forward = Math.sign(this.template.normal.z) || 1
    view.x = (this.template.origin.z - forward * 0.005 + probe.x + forward * spread) / 2
  }

  /** Shows either the four panes of procedure mode or the ordinary page. */
  setActive(active) {
    this.active = active
    this.shown = null
    document.body.classList.toggle('procedure', active)
    for (const id of ['sagittal', 'implant', 'panes']) element(id).hidden = !active
    element(active ? 'steps' : 'stage').append(element('drive'))
    set(element('mode'), t(active ? 'mode.plots' : 'mode.implant'))
    if (active) this.choosePane('axial')
    if (active) element('layers').open = false
    this.echo.plane = active ? { ...AXIAL, seen: '' } : AXIAL // in procedure mode, another part of the page explains the image
    this.echo.dirty = true
  }

  toggle() { this.setActive(!this.active) }

  /** Chooses the image that a small screen shows. */
  choosePane(pane) {
    document.body.dataset.pane = pane
    for (const button of element('panes').children) button.setAttribute('aria-pressed', String(button.dataset.pane === pane))
  }

  /* ---- received ---- */

  /** Called when all sections of a message from trocar-view have been read. */
  hearAll() { this.connecting = false }

  hearSeeds(seeds) {
    this.seeds = seeds
    this.left ??= seeds.seeds.length
  }

  /** Takes planned seeds. The tip must reach a seed's distal end. */
  hearPlan(plan) {
    const half = this.template.normal.clone().multiplyScalar(this.seedLength / 2)
    this.setPlan(plan.map(({ hole, position }) => ({ hole, point: new THREE.Vector3(...position), aim: half.clone().add({ x: position[0], y: position[1], z: position[2] }) })))
  }

  /** Takes a task's targets, which the tip only has to reach: no seeds are left. Those without a hole are only shown. */
  hearTargets(targets) {
    this.seedless = true
    this.setPlan(targets.map(({ hole, position }) => ({ hole, point: new THREE.Vector3(...position), aim: new THREE.Vector3(...position) })))
  }

  setPlan(plan) {
    this.plan = plan.map(({ hole, point, aim }) => {
      const found = hole && this.template?.find(hole) // the hole may be another guide's
      return { hole: found ? this.template.name(found) : '', point: new MaterialPoint(this.scene, point), aim, visited: false }
    })
    this.shown = null
  }

  /** A task's recording has begun: its targets have not been visited yet. */
  beginTask() { for (const entry of this.plan) entry.visited = false }

  hearDose(dose) {
    if (!this.available) return
    this.dose = dose
    shadeSlices([this.echo, this.sagittal], dose)
    element('dose').innerHTML = describeDose(dose)
  }

  /** Forgets the previous server's seeds and needles when another server has replaced it. */
  hearRestart() {
    const lost = Math.max(this.seeds.seeds.length, this.left ?? 0)
    this.seeds = NONE
    Object.assign(this, { left: 0, dropped: null, shown: null })
    this.beginTask()
    this.say(t(lost ? 'restart.seeds' : 'restart', { count: lost }), true)
  }

  /** Handles the server's reply to a command. */
  hearReply({ number, command, done, message, needle }) {
    const old = number === this.answered || this.answered === undefined && this.connecting // replies to a command sent before the page was reloaded
    this.answered = number
    if (old) return
    if (done && command === 'drop') this.dropped = { needle, depth: null, seeds: Math.max(1, this.seeds.pending[needle] ?? 1) }
    else if (done && (command === 'undo' || command === 'clear')) this.dropped = null
    if (!done && command === 'leave') this.drive.asked = false
    const known = hasText(`answer.${command}`), astray = done && command === 'drop' ? this.outOfTarget(this.tipTet) : ''
    const words = done ? `${known ? t(`answer.${command}`, { needle }) : ''}${astray}` : t(known ? `answer.${command}.refused` : 'answer.refused', { needle, message: said(message) })
    this.say(words, !done || Boolean(astray))
  }

  /** Returns a warning about a seed outside the gland, or '' if it is inside or the scene has no such region. */
  outOfTarget(tet) {
    const target = this.scene.regions.find(({ organ }) => TARGET.test(organ))?.organ, organ = organOf(this.scene, tet)
    return !target || TARGET.test(organ) ? '' : ` ${t(organ ? 'astray.organ' : 'astray.outside', { target, organ })}`
  }

  say(text, bad = false) {
    set(element('answer'), text)
    element('answer').classList.toggle('bad', bad)
  }

  /* ---- controls ---- */

  addControls() {
    element('hole-form').addEventListener('submit', (event) => { event.preventDefault(); this.chooseTyped() })
    element('drop').addEventListener('click', (event) => { this.drop(); leave(event) })
    element('undo').addEventListener('click', (event) => { this.undo(); leave(event) })
    element('fresh').addEventListener('click', (event) => { this.takeNew(); leave(event) })
    for (let count = 2; count <= STRAND; count++) element('strand').append(new Option(`${count}`, count))
    element('strand').addEventListener('change', (event) => { set(element('drop'), t(event.target.value > 1 ? 'drop.strand' : 'drop')); event.target.blur() })
    for (const button of element('panes').children) button.addEventListener('click', () => this.choosePane(button.dataset.pane))
    element('trus').addEventListener('pointermove', (event) => this.hover(this.active ? this.holeAt(event) : null))
    element('trus').addEventListener('pointerleave', () => this.hover(null))
    element('trus').addEventListener('click', (event) => {
      const hole = this.active && !event.target.closest('label, input') && this.holeAt(event)
      if (hole) this.choose(hole)
    })
    element('sagittal').addEventListener('click', (event) => { if (this.active && !event.target.closest('label, input')) this.aimAt(event) })
    element('sagittal-slice').addEventListener('input', (event) => {
      const { from, to } = this.sagittal.range
      element('sagittal-follow').checked = false
      this.sagittal.setPlace(from + event.target.value * (to - from))
    })
    new ResizeObserver(() => this.sagittal.resize()).observe(element('sagittal'))
  }

  /** Handles a key. Returns true if it belongs to procedure mode. */
  key(event) {
    const action = { KeyX: () => this.drop(), KeyU: () => this.undo(), KeyH: () => element('hole').select(), KeyE: () => this.leave(), KeyF: () => this.takeNew(),
                     KeyQ: () => this.chooseNext(), KeyZ: () => this.remove(this.drive.needle) }[actionOf(event)] ?? this.aimKey(event)
    if (!action || !this.active || event.repeat && !this.aimKey(event)) return false
    action()
    return true
  }

  /** Returns the action of + and -, which move the target deeper and shallower; undefined for other keys. */
  aimKey({ key }) {
    const by = { '+': STEP, '=': STEP, '-': -STEP }[key]
    return by && this.target && (() => this.setTarget(this.target.rest.clone().addScaledVector(this.template.normal, by)))
  }

  /** Returns the point of a slice under the pointer, in m across and up. */
  pointAt(slice, event) {
    const box = slice.canvas.getBoundingClientRect()
    return { across: slice.view.x - (2 * (event.clientX - box.left) / box.width - 1) * slice.halfWidth, up: slice.view.y - (2 * (event.clientY - box.top) / box.height - 1) * slice.halfHeight }
  }

  holeAt(event) {
    const { across, up } = this.pointAt(this.echo, event)
    const [x, y] = this.echo.unproject(across, up)
    return this.template.nearest(this.template.origin.clone().setX(x).setY(y))
  }

  hover(hole) {
    const name = hole ? this.template.name(hole) : ''
    if (name === (this.hovered ? this.template.name(this.hovered) : '')) return
    this.hovered = hole
    element('trus').style.cursor = hole ? 'pointer' : ''
    this.echo.dirty = true
  }

  chooseTyped() {
    const field = element('hole'), hole = this.template.find(field.value)
    if (hole) this.choose(hole)
    else this.say(t('hole.unknown', { name: field.value, ...this.template.last }), true)
    if (hole) field.blur()
  }

  choose(hole) {
    const taken = this.needleIn(hole)
    if (taken >= 0 && taken !== this.drive.needle) return this.say(t('hole.taken', { needle: taken, hole: this.template.name(hole) }), true)
    this.hole = { column: hole.column, row: hole.row }
    this.asked = null
    this.again = true // even for the same hole, because the needle may have been steered away from it
    element('hole').value = this.template.name(hole)
    this.say('')
    this.aimAtPlan() || this.setTarget(this.template.onAxis(this.hole, this.template.depthOf(this.middle())))
    for (const slice of [this.echo, this.sagittal]) slice.dirty = true
  }

  /** Returns the middle of the organs. */
  middle() { return new THREE.Vector3(this.echo.view.x, this.echo.view.y, this.sagittal.probe.x) }

  /** Aims at the deepest target of the hole that has not been visited yet, or at its deepest planned seed that has not been placed yet. */
  aimAtPlan() {
    const name = this.template.name(this.hole), entries = this.plan.filter(({ hole }) => hole === name).sort((a, b) => this.template.depthOf(b.aim) - this.template.depthOf(a.aim))
    const next = this.seedless ? entries.find(({ visited }) => !visited) ?? entries[0] : entries[this.placedIn(name)]
    this.planned = Boolean(next)
    if (next) this.setTarget(next.aim)
    return this.planned
  }

  /** Returns how many seeds have been placed through a hole. */
  placedIn(name) {
    const number = this.template.number(this.template.find(name))
    return this.seeds.seeds.filter(({ guide, hole }) => guide === this.template.index && hole === number).length
  }

  /** True if what is planned for a hole has been done: all its seeds are placed, or its targets visited. */
  isDone(name) {
    const entries = this.plan.filter(({ hole }) => hole === name)
    return entries.length > 0 && (this.seedless ? entries.every(({ visited }) => visited) : name !== '' && this.placedIn(name) >= entries.length)
  }

  /** Notes which targets of the chosen hole the tip is at. A tip that goes on past a target has to come back. */
  noteVisits(tip, depth) {
    if (!this.seedless || !this.hole || !tip || !(depth > 0)) return
    const name = this.template.name(this.hole)
    for (const [i, entry] of this.plan.entries()) {
      if (entry.hole !== name) continue
      const along = this.plannedNow[i].clone().sub(tip).dot(this.template.normal)
      if (along < AT_TARGET) entry.visited = along > -AT_TARGET
    }
  }

  /** `rest`: in the undeformed tissue. */
  setTarget(rest) {
    this.target = new MaterialPoint(this.scene, rest)
    this.shown = null
    remember(this.scene.path, { hole: this.hole, target: rest.toArray(), planned: this.planned })
  }

  aimAt(event) {
    if (!this.hole) return this.say(t('hole.first'), true)
    const { across } = this.pointAt(this.sagittal, event), { z } = this.template.normal
    if (Math.abs(z) > 0.5) this.setTarget(this.template.onAxis(this.hole, (across - this.template.place(this.hole).z) / z))
  }

  drop() { if (this.drive.steering) this.link.drop(Number(element('strand').value)); else this.say(t('drive.first'), true) }
  undo() { if (this.drive.steering) this.link.undo(); else this.say(t('drive.first'), true) }

  /* ---- several needles ---- */

  /** Returns the needle in this hole of the template, or -1. */
  needleIn({ column, row }) {
    return this.needles.findIndex(({ line }) => {
      const hole = this.template.holeOf(line)
      return hole?.column === column && hole.row === row
    })
  }

  /** True if a needle is resting, held, or in the template. */
  isInUse(needle) {
    const { state, owned } = this.states[needle] ?? {}
    return Boolean(state) && (state !== 'held' || owned !== 'nobody' || Boolean(this.template.holeOf(this.needles[needle].line)))
  }

  /** True if a needle is resting, or if nobody holds it. */
  isFree(needle) {
    const { state, owned } = this.states[needle] ?? {}
    return state === 'resting' || state === 'held' && owned === 'nobody'
  }

  leave() {
    if (!this.drive.steering) return this.say(t('drive.first'), true)
    this.drive.asked = true // this page itself asks for the release
    this.link.leave()
  }

  /** Takes the first needle that is not in use. Keeps the chosen hole if that is free. */
  takeNew() {
    if (this.drive.driving) return this.say(t(this.drive.lies ? 'leave.first' : 'release.first'), true)
    const needle = this.needles.findIndex((_, i) => this.states[i]?.state === 'held' && !this.isInUse(i))
    if (needle < 0) return this.say(t('needles.used', { count: this.needles.length }), true)
    if (this.hole && this.needleIn(this.hole) >= 0) this.forgetHole()
    this.say('')
    this.take(needle)
  }

  take(needle) {
    this.chooseNeedle(needle)
    this.drive.take()
  }

  remove(needle) {
    if (!this.isFree(needle)) return this.say(t('needle.held', { needle, pull: PULL }), true)
    this.link.remove(needle)
  }

  chooseNext() {
    if (this.drive.driving) return this.say(t('letGo.first'), true)
    const count = this.needles.length, next = Array.from({ length: count }, (_, i) => (this.drive.needle + 1 + i) % count).find((i) => this.isInUse(i))
    if (next !== undefined) this.chooseNeedle(next)
  }

  forgetHole() {
    Object.assign(this, { hole: null, target: null, targetNow: null, planned: false, shown: null })
    element('hole').value = ''
    remember(this.scene.path, null)
  }

  /** Reads the A and B buttons of a gamepad. */
  readGamepad() {
    const pad = navigator.getGamepads?.().find((p) => p), pressed = [0, 1].map((i) => Boolean(pad?.buttons[i]?.pressed)), before = this.pressed ?? [false, false]
    this.pressed = pressed
    if (!this.drive.steering) return
    if (pressed[0] && !before[0]) this.drop()
    if (pressed[1] && !before[1]) this.undo()
  }

  /* ---- drawing ---- */

  get needles() { return this.stage.needles }
  get then() { return this.seedless ? '' : t('next.then') }
  get seedLength() { return this.scene.seedLength }

  /** Called in each frame. `picture` is on display; `following` says whether it is live. */
  show(picture, following, chosen) {
    if (!this.scene) return
    const { seeds } = following && this.scene.live ? this.seeds : picture?.seeds ?? NONE
    if (this.active) this.readGamepad()
    const nodes = this.stage.anatomy.place.array, tip = this.needles[chosen].tip, planned = this.plan.map(({ point }) => point.at(nodes))
    const places = [...seeds.map(({ position }) => [...position]), ...planned.map((point) => point.toArray()), ...(this.active ? [[picture?.time], tip?.toArray() ?? []] : [])]
    const state = `${seeds.length} ${places.map((place) => place.map((x) => x?.toFixed(5)))}`
    if (state === this.shown) return
    this.shown = state
    this.seedsNow = seeds
    this.plannedNow = planned
    this.targetNow = this.target?.at(nodes)
    this.models.show(seeds, this.plannedNow, this.active ? this.targetNow : null, this.template?.normal ?? ALONG)
    this.stage.dirty = true
    this.echo.dirty = true
    if (!this.active) return
    this.bevels = this.needles.map((needle, i) => this.bevelOf(picture?.needles[i]))
    this.sagittal.show(nodes, this.needles.map(({ line }) => line))
    if (element('sagittal-follow').checked) this.follow(tip)
  }

  /** Moves the sagittal slice to the tip or, while the needle is outside the template, to the chosen hole. */
  follow(tip) {
    const { from, to } = this.sagittal.range, inside = tip && this.template.depthOf(tip) > 0
    const place = inside ? tip.x : this.hole ? this.template.place(this.hole).x : this.echo.view.x
    this.sagittal.setPlace(Math.min(Math.max(place, from), to))
    element('sagittal-slice').value = (this.sagittal.place - from) / (to - from)
  }

  /** Returns the direction that the bevel faces: the base's y axis, turned by the roll of the tip. */
  bevelOf(shape) {
    if (!shape) return null
    const [w, x, y, z] = shape.orientation, base = new THREE.Quaternion(x, y, z, w)
    return new THREE.Vector3(0, 1, 0).applyAxisAngle(new THREE.Vector3(0, 0, 1), shape.tipLead ?? 0).applyQuaternion(base)
  }

  draw(coarse) { if (this.active) this.sagittal.draw(coarse) }

  /* ---- words ---- */

  /** Called several times per second. Describes the current state and the next step in words. */
  describe(status, state, history, chosen) {
    this.drive.lies = false
    if (!this.active) return
    const needle = this.needles[chosen], tip = needle.tip, depths = history.tracks.map(({ count, columns }) => (count ? columns[7][count - 1] : 0)), depth = this.isOut(needle) ? 0 : depths[chosen]
    this.states = status.needles ?? []
    this.adoptHole(chosen)
    this.goToHole(status, depth)
    this.noteTip(tip, depth)
    this.noteVisits(tip, depth)
    this.drive.lies = depth > 0 && this.states[chosen]?.state === 'held'
    this.noteSeeds(chosen, depth)
    this.listNeedles(chosen)
    this.showAim(tip)
    const step = state.name === 'live' ? this.nextStep(tip, depth, chosen, this.states[chosen]?.state) : `${state.title ?? ''}.`
    set(element('next'), step)
    const pending = this.seeds.pending[chosen] > 0
    element('drop').disabled = !this.drive.steering || pending
    // the chosen needle can itself be the new one unless it is in use
    element('fresh').disabled = state.name !== 'live' || Boolean(status.driven) || !this.isInUse(chosen)
    element('undo').disabled = !this.drive.steering || !(pending || this.seeds.seeds.some(({ needle }) => needle === chosen))
  }

  /** True if the needle is in front of the template. The newest sample cannot tell: its depth may be from before the needle was removed, or from
   * another server. */
  isOut({ tip, line }) { return Boolean(tip) && this.template.depthOf(tip) <= 0 && !this.template.holeOf(line) }

  /** If no hole has been chosen, chooses the one that the driven needle is in. */
  adoptHole(chosen) {
    const hole = !this.hole && this.drive.driving && this.template.holeOf(this.needles[chosen].line)
    if (hole) this.choose(hole)
  }

  /** Sends the driven needle to the chosen hole once it is outside the tissue. Until trocar-view has acknowledged the hole, no forward commands are sent. */
  goToHole(status, depth) {
    const { state, owned } = this.states[this.drive.needle] ?? {}, { guide, column, row, approaching } = status.hole ?? {}
    this.approaching = Boolean(approaching)
    this.waits = false
    if (!this.drive.steering || !this.hole || depth !== 0) return
    const known = guide === this.template.index && column === this.hole.column && row === this.hole.row, now = performance.now()
    if (known && !this.again) return
    this.waits = true
    if (state !== 'held' || owned !== 'here' || now - (this.asked ?? -Infinity) < ASK_AGAIN) return
    this.asked = now
    this.again = false
    this.link.goToHole(this.template.index, this.hole.column, this.hole.row)
  }

  /** Finds the tetrahedron that contains the tip in the deformed tissue, and whether the tip has come out on the far side. */
  noteTip(tip, depth) {
    this.tipTet = tip && depth > 0 ? tetAt(this.scene, this.stage.anatomy.place.array, tip.toArray(), this.tipTet) : -1
    const entered = this.template.guide.thickness ?? 0
    this.isThrough = depth > THROUGH && this.tipTet < 0 && Boolean(tip) && this.template.depthOf(tip) > entered
  }

  /** Reports when seeds have been left in the tissue. */
  noteSeeds(chosen, depth) {
    const { seeds, pending } = this.seeds
    if (this.left === null) return // no seeds message has arrived yet
    if (pending[chosen] > 0) this.dropped ??= { needle: chosen, depth: null, seeds: pending[chosen] }
    if (this.dropped?.needle === chosen && pending[chosen] > 0) {
      this.dropped.depth ??= depth
      this.dropped.seeds = Math.max(this.dropped.seeds, pending[chosen])
    }
    if (seeds.length > this.left) {
      if (!(pending[chosen] > 0)) this.dropped = null
      this.sayLeft(seeds.slice(this.left))
    }
    if (seeds.length !== this.left && this.hole) this.aimAtPlan()
    this.left = seeds.length
    set(element('seed-count'), this.countSeeds(seeds.length, pending, chosen))
  }

  /** Reports `left`, the seeds that have been left in the tissue since the last report. */
  sayLeft(left) {
    const count = this.seeds.seeds.length, astray = left.map(({ restPosition }) => this.outOfTarget(new MaterialPoint(this.scene, new THREE.Vector3(...restPosition)).tet ?? -1)).find(Boolean)
    this.say(`${t('seed.left', { count })}${astray ?? ''}`, Boolean(astray))
    this.onSeed()
  }

  /** Says how many seeds are in the tissue and in the needle. */
  countSeeds(count, pending, chosen) {
    const tissue = t('seeds.tissue', { count })
    if (count === 0 && !pending.some(Boolean)) return t('seeds.none')
    return pending[chosen] ? t('seeds.needle', { tissue, count: pending[chosen] }) : tissue
  }

  /** Lists the needles in use, and marks the chosen one. */
  listNeedles(chosen) {
    const listed = this.needles.map((_, i) => i).filter((i) => i === chosen || this.isInUse(i))
    const rows = listed.map((i) => {
      const { state } = this.states[i] ?? {}, hole = this.template.holeOf(this.needles[i].line)
      return { needle: i, chosen: i === chosen, free: this.isFree(i) && (state === 'resting' || Boolean(hole)), driving: this.drive.driving,
               cells: [`${i}`, this.stateOf(i), hole ? this.template.name(hole) : '–', hole ? `${mm(this.template.depthOf(this.needles[i].tip))} mm` : '–'] }
    })
    const text = JSON.stringify(rows), body = element('needles').tBodies[0]
    if (text === this.listed) return
    this.listed = text
    const focus = document.activeElement?.getAttribute('aria-label')
    body.replaceChildren(...rows.map((row) => this.rowOf(row)))
    if (focus) [...body.querySelectorAll('button')].find((button) => button.getAttribute('aria-label') === focus)?.focus()
  }

  /** Says whether a needle is free, held or resting. */
  stateOf(needle) {
    const { state, owned } = this.states[needle] ?? {}, key = state && state !== 'held' ? `needle.${state}` : `owner.${owned}`
    return hasText(key) ? t(key) : '–'
  }

  rowOf({ needle, chosen, free, driving, cells }) {
    const row = document.createElement('tr'), buttons = document.createElement('td')
    const button = (key, act, disabled) => {
      const made = Object.assign(document.createElement('button'), { textContent: t(key), title: t(`${key}.title`), disabled })
      made.setAttribute('aria-label', t(`${key}.label`, { needle }))
      made.addEventListener('click', act)
      buttons.append(made)
    }
    if (free) {
      button('needle.take', () => this.take(needle), driving)
      button('needle.remove', () => this.remove(needle), false)
    }
    row.classList.toggle('chosen', chosen)
    row.addEventListener('click', (event) => { if (!event.target.closest('button') && !this.drive.driving) this.chooseNeedle(needle) })
    row.append(...cells.map((cell) => Object.assign(document.createElement('td'), { textContent: cell })), buttons)
    return row
  }

  /** Returns how far (m) the tip is from the target along the needle and across it. */
  tipError(tip) {
    const off = this.targetNow.clone().sub(tip), along = off.dot(this.template.normal)
    return { along, aside: off.addScaledVector(this.template.normal, -along).length() }
  }

  showAim(tip) {
    const known = this.target && this.targetNow && tip
    set(element('target'), this.target ? t('target.place', { hole: this.template.name(this.hole), depth: mm(this.template.depthOf(this.target.rest)) }) : '–')
    if (!known) return set(element('tip-error'), '–')
    const { along, aside } = this.tipError(tip)
    set(element('tip-error'), t(along >= 0 ? 'target.go' : 'target.deep', { along: mm(Math.abs(along)), aside: mm(aside) }))
  }

  nextStep(tip, depth, chosen, needleState) {
    if (needleState === 'leaving') return t('next.leaving')
    if (needleState === 'taking') return t('next.taking')
    if (needleState === 'resting') return `${t('next.resting', { needle: chosen })} ${this.whatNext()}`
    if (!this.hole) return t('next.hole')
    const hole = this.template.name(this.hole)
    const done = this.isDone(hole)
    if (done && depth === 0) return `${t('next.done', { hole })} ${this.whatNext()}`
    if (!this.drive.steering && depth > 0) return t('next.nobody')
    if (!this.drive.steering) return t('next.drive', { hole })
    if (this.seeds.pending[chosen] > 0) {
      const { seeds = this.seeds.pending[chosen], depth: from } = this.dropped ?? {}, length = (seeds - 1) * this.scene.seedSpacing + this.seedLength
      return t('next.back.seeds', { length: mm(Math.max(length - ((from ?? depth) - depth), 0)), pull: PULL, count: seeds })
    }
    const current = this.template.holeOf(this.needles[chosen].line)
    if (depth > 0 && current && this.template.name(current) !== hole) return t('next.back.hole', { pull: PULL, hole })
    if (this.isThrough) return t('next.through', { pull: PULL })
    if (depth === 0 && (this.waits || this.approaching)) return t('next.moves', { hole, push: PUSH })
    if (depth === 0 && tip && this.template.aside(tip, this.hole).length() > IN_LINE && this.drive.age.at(performance.now()) < LATE) return t('next.beside', { hole })
    if (depth === 0) return t(TOUCH ? 'next.push.touch' : 'next.push')
    const { along } = this.tipError(tip)
    if (this.seedless && Math.abs(along) < AT_TARGET) return `${t('next.at')} ${this.whatNext(true)}`
    if (done) return `${t('next.done', { hole })} ${this.whatNext(true)}`
    if (this.seedHere(chosen) && !this.planned) return t('next.left')
    if (along > AT_TARGET) return `${t('next.on', { push: PUSH, along: mm(along) })} ${this.then}`
    if (along < -AT_TARGET) return `${t('next.back', { pull: PULL, along: mm(-along) })} ${this.then}`
    return t('next.drop')
  }

  /** Says which planned hole is next, or that there is none; '' without a plan. `inside`: the needle is in the tissue. */
  whatNext(inside = false) {
    const open = this.plan.filter(({ hole }) => !this.isDone(hole)), next = open.find(({ hole }) => hole)
    const out = inside ? `${t('next.out', { pull: PULL })} ` : ''
    if (next) return `${out}${t('next.planned', next)}`
    if (this.plan.length === 0 || open.length > 0) return ''
    if (this.judged) return t(inside ? 'next.finish.inside' : 'next.finish', { pull: PULL })
    return this.seedless ? '' : `${out}${t('next.complete')}`
  }

  /** True if the newest seed came from this needle in the chosen hole. */
  seedHere(chosen) {
    const last = this.seeds.seeds.at(-1)
    return last?.needle === chosen && last.hole === this.template.number(this.hole)
  }
}
