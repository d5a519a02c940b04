// The ultrasound probe: its body, the force on the hand that holds it, the keys that move it, and the image planes, which move with it.
import * as THREE from 'three'
import { actionOf, leave } from '../drive.js'
import { t } from '../words/words.js'

const FREE = '#8fa6bd', PRESSING = '#e8a33d', STOPPED = '#e05252'
const MOVED = 1e-5 // m; the image planes ignore smaller motions of the probe
const STILL = [0, 0, 0, 0, 0, 0]

/** Returns a cylinder with a rounded end along +z, its base at 0. */
function body({ radius, tipRadius, length }) {
  const profile = [[0, 0], [radius, 0]]
  for (let i = 0; i <= 16; i++) {
    const angle = (Math.PI / 2) * (i / 16)
    profile.push([radius - tipRadius * (1 - Math.cos(angle)), length - tipRadius * (1 - Math.sin(angle))])
  }
  profile.push([0, length])
  const geometry = new THREE.LatheGeometry(profile.map(([x, y]) => new THREE.Vector2(x, y)), 40).rotateX(Math.PI / 2)
  return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: FREE, transparent: true, opacity: 0.55, side: THREE.DoubleSide, depthWrite: false }))
}

function colour({ contacts, stopped }) { return stopped ? STOPPED : contacts ? PRESSING : FREE }

function describe({ contacts, force, stopped }) {
  const pressing = contacts ? t('probe.force', { force: Math.hypot(...force).toFixed(2), count: contacts }) : t('probe.free')
  return stopped ? t('probe.stopped', { probe: pressing }) : pressing
}

export class Probe {
  /** `setSlice`: moves the axial image to a given z. */
  constructor({ stage, echo, procedure, drive, link, setSlice }) {
    Object.assign(this, { stage, echo, procedure, drive, link, setSlice, moving: false, shape: null })
    this.button = Object.assign(document.createElement('button'), { id: 'move-probe', textContent: t('probe.move'), title: t('probe.move.title'), hidden: true })
    this.words = Object.assign(document.createElement('p'), { id: 'probe-force', hidden: true })
    document.getElementById('controls').append(this.button)
    document.getElementById('drive-note').before(this.words)
    this.button.addEventListener('click', (event) => { this.toggle(); leave(event) })
    for (const slice of [echo, procedure.sagittal]) slice.overlays.push((image, ink) => this.outline(image, ink))
    drive.send = (command, number) => {
      link.steer(this.moving ? STILL : command, number)
      if (this.moving) link.moveProbe(command, number)
    }
    const ofNeedle = drive.limit
    drive.limit = () => (this.moving ? 1 : ofNeedle())
  }

  load(scene) {
    this.shape = scene.probe ?? null
    this.live = scene.live
    this.last = null
    for (const node of [this.button, this.words, document.getElementById('probe-key')]) node.hidden = !this.shape
    this.setMoving(false)
    if (!this.shape) return
    this.body = body(this.shape)
    this.body.visible = false
    this.stage.content.add(this.body)
    this.words.textContent = t('probe.none')
  }

  /** Draws the probe's outline: a circle in the axial image, its sides and end in the sagittal image. */
  outline(image, ink) {
    if (!this.last) return
    const { radius, length, tipRadius } = this.shape, { x, y } = image.project(this.place(this.last)), unit = image.unit
    ink.strokeStyle = colour(this.last)
    ink.lineWidth = 1.5 * unit
    ink.beginPath()
    if (image.plane.across === 'x') {
      const [left, up] = image.toPixel(x, y)
      ink.arc(left, up, Math.abs(image.toPixel(x + radius, y)[0] - left), 0, 2 * Math.PI)
    } else {
      const [end, middle] = image.toPixel(x, y), size = Math.abs(image.toPixel(x, y + radius)[1] - middle), [base] = image.toPixel(x - length + tipRadius, y)
      ink.moveTo(base, middle - size)
      ink.lineTo(end, middle - size)
      ink.arc(end, middle, size, -Math.PI / 2, Math.PI / 2, end < base)
      ink.lineTo(base, middle + size)
    }
    ink.stroke()
  }

  /** Chooses whether the controls move the probe or the needle. What they moved before stops, and a key that is down must be pressed again. */
  setMoving(moving) {
    if (moving !== this.moving) this.drive.rest()
    if (this.moving && !moving) this.link.moveProbe(STILL)
    this.moving = moving
    this.button.setAttribute('aria-pressed', String(moving))
    this.button.classList.toggle('held', moving)
  }

  toggle() { if (this.shape && this.drive.steering) this.setMoving(!this.moving) }

  /** Handles a key. Returns true if it controls the probe. */
  key(event) {
    if (actionOf(event) !== 'KeyB' || !this.shape || event.repeat) return false
    this.toggle()
    return true
  }

  /** Called in each frame with the picture on display. */
  show(picture) {
    const probe = picture?.probe
    if (!this.drive.driving) this.setMoving(false)
    if (!this.shape || !probe || probe === this.last) return
    const first = !this.last, moved = first || this.place(probe).distanceTo(this.place(this.last)) > MOVED
    this.last = probe
    this.body.visible = true
    this.body.position.fromArray(probe.position)
    this.body.quaternion.copy(this.turn(probe))
    this.body.material.color.set(colour(probe))
    this.stage.dirty = this.echo.dirty = this.procedure.sagittal.dirty = true
    this.words.textContent = describe(probe)
    if (moved) this.aim(probe, first)
  }

  turn({ orientation: [w, x, y, z] }) { return new THREE.Quaternion(x, y, z, w) }

  /** Returns the point that both images pass through: on the probe's axis, where the rounded end begins. */
  place(probe) { return new THREE.Vector3(0, 0, this.shape.length - this.shape.tipRadius).applyQuaternion(this.turn(probe)).add(new THREE.Vector3().fromArray(probe.position)) }

  /** Moves the image planes with the probe. Illustrations stay parallel to the mesh's planes, while computed images tilt with the probe. In a log, the
   * planes stay put when the probe first appears. */
  aim(probe, first) {
    const { x, y, z } = this.place(probe), inside = (slice, place) => Math.min(Math.max(place, slice.range.from), slice.range.to)
    const slices = [[this.echo, x, 'follow'], ...(this.procedure.available ? [[this.procedure.sagittal, z, 'sagittal-follow']] : [])]
    for (const [slice, across, follow] of slices) {
      slice.tissue.material.uniforms.probe.value = new THREE.Vector2(across, y)
      slice.dirty = true
      if (!first || this.live) document.getElementById(follow).checked = false
    }
    if (first && !this.live) return
    this.setSlice(inside(this.echo, z))
    if (this.procedure.available) this.procedure.sagittal.setPlace(inside(this.procedure.sagittal, x))
  }
}
