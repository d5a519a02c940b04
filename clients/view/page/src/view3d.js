// The 3D view: camera, lights, rendering, and planes that can be dragged.
import * as THREE from 'three'
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js'
import { Anatomy } from './anatomy.js'
import { discard } from './buffers.js'
import { hubColour, ramp } from './colours.js'
import { drawGuides } from './guides.js'
import { Needle } from './needle.js'
import { Tracks } from './tracks.js'
import { Slicer } from './slicer.js'

const MOVING = 0.5, STILL = 1.5 // resolution factors with software rendering, in motion and at rest
const REST = 1000 // ms without a change before the view counts as at rest; longer than the interval between pictures on a busy machine
const PACE = 66, PACE_BESIDE_IMAGES = 150 // ms, shortest time between drawings with software rendering; computed ultrasound images need CPU time as well
const VIEWS = { 1: [-0.78, 0.42, -0.46], 2: [-1, 0, 0], 3: [-0.001, 1, 0], 4: [0, 0.3, -1] } // directions of the camera from the centre
const AXIS = { x: new THREE.Vector3(1, 0, 0), y: new THREE.Vector3(0, 1, 0), z: new THREE.Vector3(0, 0, 1) }

function rampTexture() {
  const data = new Uint8Array(4 * 256)
  for (let i = 0; i < 256; i++) data.set([...ramp(i / 255).map((c) => 255 * c), 255], 4 * i)
  const texture = new THREE.DataTexture(data, 256, 1)
  texture.colorSpace = THREE.SRGBColorSpace
  texture.magFilter = THREE.LinearFilter
  texture.needsUpdate = true
  return texture
}

/** Returns the factor by which to multiply the camera's distance for this aspect ratio, to keep the same width visible. */
const room = (aspect) => Math.max(1, 1.25 / aspect)

function drawsInSoftware() {
  const graphics = document.createElement('canvas').getContext('webgl2'), info = graphics?.getExtension('WEBGL_debug_renderer_info')
  return Boolean(info) && /swiftshader|llvmpipe|software/i.test(graphics.getParameter(info.UNMASKED_RENDERER_WEBGL))
}

const WAITING = 4 // show all waiting needles if there are no more than this, otherwise only the first

/** Returns a picture with the needles at their waiting poses and undeformed tissue. */
function pictureAtHome({ parkingPoses, needle: { length }, nodes }) {
  const needles = parkingPoses.slice(0, parkingPoses.length > WAITING ? 1 : WAITING).map(({ position, orientation: [w, x, y, z] }) => {
    const tip = new THREE.Vector3(0, 0, length).applyQuaternion(new THREE.Quaternion(x, y, z, w)).add(new THREE.Vector3(...position))
    return { orientation: [w, x, y, z], joints: new Float32Array([...position, ...tip]), contacts: new Float32Array(0) }
  })
  return { scale: 0, needles, displacement: new Int16Array(nodes.length) }
}

/** A rectangular frame normal to an axis, which can be dragged along that axis. */
class Plane {
  constructor(axis, colour, box) {
    this.axis = axis
    this.box = box
    const [u, v] = ['x', 'y', 'z'].filter((name) => name !== axis), grown = box.clone().expandByScalar(0.003)
    const corner = (a, b) => { const p = new THREE.Vector3(); p[u] = grown[a][u]; p[v] = grown[b][v]; return p }
    const corners = [corner('min', 'min'), corner('max', 'min'), corner('max', 'max'), corner('min', 'max')]
    this.frame = new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(corners), new THREE.LineBasicMaterial({ color: colour }))
    this.colour = colour
    this.set(0.5)
  }

  /** `part`: position as a fraction (0 to 1) of the body's extent along the axis. */
  set(part) {
    this.part = Math.min(Math.max(part, 0), 1)
    this.place = this.box.min[this.axis] + this.part * (this.box.max[this.axis] - this.box.min[this.axis])
    this.frame.position[this.axis] = this.place
  }

  move(place) { this.set((place - this.box.min[this.axis]) / (this.box.max[this.axis] - this.box.min[this.axis])) }
}

export class Stage {
  constructor(canvas) {
    this.canvas = canvas
    this.slow = drawsInSoftware()
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !this.slow, alpha: true })
    this.renderer.localClippingEnabled = true
    this.world = new THREE.Scene()
    this.camera = new THREE.PerspectiveCamera(32, 1, 0.005, 3)
    this.controls = new OrbitControls(this.camera, canvas)
    this.controls.enableDamping = !this.slow
    this.controls.addEventListener('change', () => { this.dirty = true })
    this.texture = rampTexture()
    this.clipping = []
    this.addLights()
    this.addDragging()
    this.dirty = true   // true if something has changed since the last rendering
    this.end = null     // GPU fence at the end of the last rendering
    this.coarse = false // true if the last rendering was at low resolution
    this.changed = 0    // ms, by performance.now(), when something last changed
    this.drawn = -PACE_BESIDE_IMAGES // ms, by performance.now(), when last rendered
    this.onSlice = () => {}
    this.onCut = () => {}
  }

  addLights() {
    this.world.add(new THREE.HemisphereLight('#ffffff', '#5a6470', 1.6))
    const key = new THREE.DirectionalLight('#ffffff', 2.2)
    key.position.set(-0.5, 1, -0.4)
    this.world.add(key)
  }

  load(scene) {
    if (this.content) discard(this.content.removeFromParent())
    this.scene = scene
    this.anatomy = new Anatomy(scene, this.texture, new Slicer(scene), this.clipping)
    this.needles = scene.parkingPoses.map((home, i) => new Needle(scene, hubColour(i)))
    this.guides = drawGuides(scene.guides)
    this.tracks = new Tracks(scene)
    const place = new THREE.BufferAttribute(scene.nodes, 3), box = new THREE.Box3().setFromBufferAttribute(place)
    this.box = box
    this.slice = new Plane('z', '#37d0ff', box)
    this.content = new THREE.Group().add(this.anatomy.group, ...this.needles.map(({ group }) => group), this.guides, this.tracks.group, this.slice.frame)
    this.world.add(this.content)
    this.setCut('')
    this.showHome()
    this.look(1)
  }

  /** Fits the body, and the needles outside it, into the view. */
  look(number) {
    const middle = this.box.getCenter(new THREE.Vector3()), size = this.box.getSize(new THREE.Vector3())
    middle.z -= 0.12 * size.z
    const reach = size.length() / (Math.sin(THREE.MathUtils.degToRad(this.camera.fov / 2))) * (number === 4 ? 0.48 : 0.52)
    this.controls.target.copy(middle)
    this.camera.position.copy(middle).addScaledVector(new THREE.Vector3(...VIEWS[number]).normalize(), reach * room(this.camera.aspect))
    this.controls.update()
    this.dirty = true
  }

  /** Turns the view about its target by `turn`, tilts it by `tilt` (rad), and multiplies its distance by `farther`. */
  orbit(turn, tilt, farther) {
    const { position, up } = this.camera, { target } = this.controls, level = new THREE.Quaternion().setFromUnitVectors(up, new THREE.Vector3(0, 1, 0))
    const at = new THREE.Spherical().setFromVector3(position.clone().sub(target).applyQuaternion(level))
    position.setFromSpherical(new THREE.Spherical(at.radius * farther, at.phi + tilt, at.theta + turn).makeSafe()).applyQuaternion(level.invert()).add(target)
    this.controls.update()
    this.dirty = true
  }

  /** Moves what is in view to the right and up, by fractions of the view's height. */
  pan(right, up) {
    const { camera, controls } = this, height = 2 * camera.position.distanceTo(controls.target) * Math.tan(THREE.MathUtils.degToRad(camera.fov / 2))
    const by = new THREE.Vector3(-right, -up, 0).multiplyScalar(height).applyQuaternion(camera.quaternion)
    camera.position.add(by)
    controls.target.add(by)
    controls.update()
    this.dirty = true
  }

  /** Cuts the body normal to `axis` and removes the part on the viewer's side. '' means no cut. */
  setCut(axis, part = 0.5) {
    if (this.cutPlane) discard(this.cutPlane.frame.removeFromParent())
    this.cutPlane = axis ? new Plane(axis, '#ffb454', this.box) : null
    if (this.cutPlane) {
      this.cutPlane.set(part)
      this.content.add(this.cutPlane.frame)
    }
    this.recut()
  }

  recut() {
    const cut = this.cutPlane
    this.clipping.length = 0
    if (cut) {
      this.cutSide = Math.sign(this.camera.position[cut.axis] - cut.place) || 1
      this.clipping.push(new THREE.Plane(AXIS[cut.axis].clone().multiplyScalar(-this.cutSide), this.cutSide * cut.place))
    }
    this.anatomy.cut(cut ? AXIS[cut.axis].toArray() : null, cut?.place)
    this.dirty = true
  }

  /** Shows a picture received from trocar-view. Returns the largest displacement (m). */
  show(picture) {
    this.picture = picture
    this.needles.forEach((needle, i) => needle.show(picture.needles[i]))
    const largest = this.anatomy.deform(picture)
    this.tracks.show(picture.needles, this.anatomy.place.array)
    if (this.cutPlane) this.recut()
    this.dirty = true
    return largest
  }

  /** Sets the displacement (m) at the top of the colour scale, and recolours the cut. */
  setRange(range) {
    this.anatomy.setRange(range)
    if (this.cutPlane) this.recut()
    this.dirty = true
  }

  /** Shows the needles outside the body, for a server that has not sent a picture yet. */
  showHome() { this.show(pictureAtHome(this.scene)) }

  setTheme(dark) {
    this.anatomy.setTheme(dark)
    for (const needle of this.needles) needle.tipColour = dark ? '#ffffff' : '#17212b'
    this.needles.forEach((needle, i) => needle.show(this.picture.needles[i]))
    this.dirty = true
  }

  setLayer(name, visible) {
    const all = (part) => this.needles.map((needle) => needle[part])
    const own = { needle: all('body'), guides: [this.guides], tracks: [this.tracks.group], contacts: all('dots'), forces: all('arrows'), 'slice frame': [this.slice.frame] }
    for (const object of own[name] ?? this.anatomy.layers.get(name) ?? []) object.visible = visible
    this.dirty = true
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas
    this.setSize(clientWidth, clientHeight)
  }

  setSize(width, height) {
    if (width === 0 || height === 0) return
    this.renderer.setSize(width, height, false)
    const { position, aspect } = this.camera, { target } = this.controls
    position.sub(target).multiplyScalar(room(width / height) / room(aspect)).add(target)
    this.camera.aspect = width / height
    this.camera.updateProjectionMatrix()
    this.dirty = true
  }

  /** Renders at a given size. Returns the canvas, which is valid until this task ends. */
  drawAt(width, height, ratio) {
    this.setSize(width, height)
    this.controls.update()
    this.render(false, ratio)
    return this.canvas
  }

  /** Renders if something has changed, and at full resolution once the view is at rest. `besideImages`: computed images are arriving. Returns whether
   * it rendered. */
  draw(now, besideImages) {
    this.controls.update()
    if (!this.scene) return false
    if (this.dirty && this.slow && now - this.drawn < (besideImages ? PACE_BESIDE_IMAGES : PACE)) return false
    if (this.dirty) this.changed = now
    if (!this.dirty && !(this.coarse && now - this.changed > REST)) return false
    this.drawn = now
    this.render(this.slow && this.dirty)
    return true
  }

  /** `coarse`: at low resolution; `ratio`: rendered pixels per pixel of the requested size. */
  render(coarse, ratio = coarse ? MOVING : this.slow ? STILL : Math.min(devicePixelRatio, 2)) {
    if (this.cutPlane && this.cutSide !== (Math.sign(this.camera.position[this.cutPlane.axis] - this.cutPlane.place) || 1)) this.recut()
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio)
    this.anatomy.smoothen()
    this.renderer.render(this.world, this.camera)
    this.coarse = coarse
    this.dirty = false
    const gl = this.renderer.getContext()
    gl.deleteSync(this.end)
    this.end = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0)
    gl.flush()
  }

  /** True if the GPU has finished the last rendering. */
  finished() {
    const gl = this.renderer.getContext()
    if (this.end && gl.getSyncParameter(this.end, gl.SYNC_STATUS) === gl.UNSIGNALED) return false
    gl.deleteSync(this.end)
    this.end = null
    return true
  }

  /** Returns the metres per pixel at the camera's target. */
  metresPerPixel(height = this.canvas.clientHeight) {
    const distance = this.camera.position.distanceTo(this.controls.target)
    return 2 * distance * Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2)) / height
  }

  /* ---- dragging planes ---- */

  addDragging() {
    const ray = new THREE.Raycaster()
    ray.params.Line.threshold = 0.003
    const aim = (event) => {
      const box = this.canvas.getBoundingClientRect()
      ray.setFromCamera(new THREE.Vector2(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height), this.camera)
    }
    const hit = () => [this.cutPlane, this.slice].find((plane) => plane && plane.frame.visible && ray.intersectObject(plane.frame).length)
    this.canvas.addEventListener('pointerdown', (event) => {
      if (!this.scene) return
      aim(event)
      const plane = hit(), start = plane && ray.intersectObject(plane.frame)[0].point
      if (!plane) return
      this.controls.enabled = false
      this.canvas.setPointerCapture(event.pointerId)
      this.dragged = { plane, axis: AXIS[plane.axis], start, from: plane.place }
    }, { capture: true })
    this.canvas.addEventListener('pointermove', (event) => {
      if (!this.scene) return
      aim(event)
      if (this.dragged) this.drag(ray.ray)
      else this.canvas.style.cursor = hit() ? 'grab' : ''
    })
    this.canvas.addEventListener('pointerup', () => { this.dragged = null; this.controls.enabled = true })
  }

  /** Moves the plane to the point on its axis that is closest to the pointer's ray. */
  drag(ray) {
    const { plane, axis, start, from } = this.dragged, between = start.clone().sub(ray.origin)
    const slant = axis.dot(ray.direction), across = 1 - slant * slant
    if (across < 1e-3) return
    plane.move(from + (slant * between.dot(ray.direction) - between.dot(axis)) / across)
    if (plane === this.slice) this.onSlice(plane.part)
    else { this.onCut(plane.part); this.recut() }
    this.dirty = true
  }
}
