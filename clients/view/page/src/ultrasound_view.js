// An axial or sagittal slice: the ultrasound image that trocar-view computes (clients/view/ultrasound), with outlines. For past data, logs, and planes
// that trocar-view does not compute, draws an illustration in the style of ultrasound instead.
import * as THREE from 'three'
import { bitsOfBone, hostOf, OUTSIDE } from './anatomy.js'
import { discard, Filled, show } from './buffers.js'
import { ISODOSE } from './colours.js'
import { Isolines } from './procedure/isolines.js'
import { Slicer } from './slicer.js'
import { t } from './words/words.js'

const VERTEX = `
  attribute vec3 rest; attribute float grey;
  varying vec3 seed, here; varying float level; varying vec2 place;
  void main() { seed = rest; here = position; level = grey; place = vec2(position.ACROSS, position.y); gl_Position = projectionMatrix * modelViewMatrix * vec4(place, 0.0, 1.0); }`

const FAN = `
  uniform vec2 probe; uniform vec2 reach; uniform float spread;
  // 1 inside the probe's fan, with soft edges; with LINEAR, inside a rectangle beside a probe that lies along the slice
  float fan(vec2 at) {
    #ifdef LINEAR
      vec2 aside = abs(at - probe - vec2(0.0, 0.5 * (reach.x + reach.y)));
      return smoothstep(0.0, 0.002, spread - aside.x) * smoothstep(0.0, 0.002, 0.5 * (reach.y - reach.x) - aside.y);
    #endif
    vec2 from = at - probe; float range = length(from), angle = abs(atan(from.x, from.y));
    return smoothstep(0.0, 0.0012, range - reach.x) * smoothstep(0.0, 0.0025, reach.y - range) * smoothstep(0.0, 0.02, spread - angle);
  }`

// Draws isodose lines of the seeds at their current positions.
const DOSE = `
  precision highp sampler3D;
  uniform sampler3D dose; uniform vec3 doseOrigin, doseSize; uniform float doseTop; // doseTop is 0 if there is no dose
  vec4 isoline(vec4 under, float level, float at, float slope, vec3 colour) {
    return mix(under, vec4(colour, under.a), slope > 0.0 ? 1.0 - smoothstep(0.7, 1.5, abs(at - level) / slope) : 0.0);
  }
  vec4 isodose(vec4 under) {
    vec3 at = (here - doseOrigin) / doseSize;
    bool inside = doseTop > 0.0 && all(greaterThan(at, vec3(0.0))) && all(lessThan(at, vec3(1.0)));
    float level = inside ? doseTop * texture(dose, at.zyx).r : 0.0, slope = fwidth(level);
    if (!inside) return under;
    return isoline(isoline(isoline(under, 1.0, level, slope, ISO100), 1.5, level, slope, ISO150), 2.0, level, slope, ISO200);
  }`

// Draws speckle of three grain sizes. It is fixed to the tissue, elongated across the beam, and fades with depth.
const FRAGMENT = `
  precision highp float;
  varying vec3 seed, here; varying float level; varying vec2 place;
  ${FAN}
  float hash(vec3 p) { p = fract(p * vec3(0.1031, 0.1030, 0.0973)); p += dot(p, p.yxz + 33.33); return fract((p.x + p.y) * p.z); }
  float noise(vec3 p) {
    vec3 i = floor(p), f = fract(p); f = f * f * (3.0 - 2.0 * f);
    return mix(mix(mix(hash(i), hash(i + vec3(1,0,0)), f.x), mix(hash(i + vec3(0,1,0)), hash(i + vec3(1,1,0)), f.x), f.y),
               mix(mix(hash(i + vec3(0,0,1)), hash(i + vec3(1,0,1)), f.x), mix(hash(i + vec3(0,1,1)), hash(i + vec3(1,1,1)), f.x), f.y), f.z);
  }
  ${DOSE}
  void main() {
    #ifdef LINEAR
      float depth = place.y - probe.y;
    #else
      float depth = length(place - probe);
    #endif
    float fine = noise(seed * vec3(1500.0, 2600.0, 1400.0) + 300.0), coarse = noise(seed * vec3(420.0, 560.0, 380.0) + 70.0), broad = noise(seed * vec3(110.0, 130.0, 100.0) + 20.0);
    float speckle = 0.42 + 0.75 * fine * fine + 0.42 * (coarse - 0.5) + 0.3 * (broad - 0.5);
    float fade = exp(-9.0 * max(depth - reach.x, 0.0));
    float v = level * speckle * (0.45 + 0.85 * fade);
    gl_FragColor = isodose(vec4(vec3(pow(clamp(v, 0.0, 1.0), 0.85)) * vec3(0.97, 0.99, 1.0), fan(place)));
  }`

const FLASH = `
  precision highp float;
  varying vec2 place;
  uniform vec2 needle; uniform float visible;
  ${FAN}
  // echo of the needle and reverberations behind it
  void main() {
    vec2 away = normalize(needle - probe), from = place - needle;
    float along = dot(from, away), across = dot(from, vec2(away.y, -away.x));
    float core = exp(-(across * across) / 1.6e-6 - (along * along) / 0.35e-6);
    float tail = along > 0.0 ? exp(-across * across / 0.9e-6 - along / 0.006) * (0.35 + 0.65 * pow(0.5 + 0.5 * cos(along * 3200.0), 2.0)) : 0.0;
    gl_FragColor = vec4(vec3(1.0, 0.98, 0.92), visible * fan(place) * min(core * 1.5 + 0.55 * tail, 1.0));
  }`

const SIMPLE_VERTEX = 'varying vec2 place; void main() { place = position.xy; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }'
const GREY = { bone: 0.95, gland: 0.42, host: 0.66, other: 0.55 }

const FEW = 4 // with more needles than this, draw only those in the slice, because a needle takes as long to draw as the image
const MOVING = 0.5 // resolution factor with software rendering

/** Plane of a slice: the axis normal to it and the axis that points left; y is up. `letters`: the patient's sides at the left, right, upper and lower edges. */
export const AXIAL = { name: t('slice.axial'), normal: 'z', across: 'x', seen: t('slice.along'), letters: 'RLAP' }
export const SAGITTAL = { name: t('slice.sagittal'), normal: 'x', across: 'z', seen: '', letters: 'SIAP' }
const INDEX = { x: 0, y: 1, z: 2 }
const SAME_PLANE = 0.002, NEARBY = 0.01 // m, farthest that a computed image may be from the chosen plane to be shown; NEARBY applies while it is new
const SOON = 60 // ms to wait for the image that belongs to a new picture
const NEW = 1000 // ms for which an image counts as new; while the plane is being moved, images lag behind
const FRAMES = 600 // how many drawing times are kept, for tests

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
const shaded = (colour) => `vec3(${new THREE.Color(colour).convertLinearToSRGB().toArray().map((part) => part.toFixed(4))})`

export class Echo {
  /** `canvas`: shows the tissue; `marks`: an overlay for outlines and scales. */
  constructor(canvas, marks, plane = AXIAL) {
    this.plane = plane
    this.direction = [0, 1, 2].map((i) => (i === INDEX[plane.normal] ? 1 : 0))
    this.overlays = [] // functions that draw on `marks`, called with this object and its 2D context
    this.doses = { dose: { value: null }, doseOrigin: { value: new THREE.Vector3() }, doseSize: { value: new THREE.Vector3(1, 1, 1) }, doseTop: { value: 0 } }
    this.focus = () => true // selects regions that the image must contain
    this.canvas = canvas
    this.marks = marks
    this.renderer = new THREE.WebGLRenderer({ canvas, alpha: true })
    this.world = new THREE.Scene()
    this.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1)
    this.place = 0
    this.image = null       // the newest computed image
    this.live = false       // true while the page shows live data, for which images are computed
    this.look = { gain: 0, range: 60 } // dB
    this.marked = true      // true to draw outlines, needles and seeds over the image
    this.pixels = document.createElement('canvas') // the computed image, at its own resolution
    this.isolines = new Isolines()
    this.frames = []        // ms, when computed images were first drawn
    this.dirty = true
  }

  /** Takes a computed image: see Scanner.hear. */
  showImage(image) {
    this.image = image
    this.isNew = true
    this.heard = performance.now()
    this.dirty = true
  }

  /** True if the newest computed image has only just arrived. */
  get isRecent() { return performance.now() - this.heard < NEW }

  /** True if the computed image should be shown. */
  get simulated() {
    if (!this.live || this.image === null) return false
    return Math.abs(this.image.origin[INDEX[this.plane.normal]] - this.place) < (this.isRecent ? NEARBY : SAME_PLANE)
  }

  /** Returns the plane that is shown: a point in it, unit vectors, and the point's image coordinates `at`. These run across the image (as if it were
   * not tilted) and up. */
  get frame() {
    const { across, normal } = this.plane
    if (this.simulated) return { ...this.image, at: [this.image.origin[INDEX[across]], this.image.origin[1]] }
    const unit = (axis) => [0, 1, 2].map((i) => (i === INDEX[axis] ? 1 : 0)), origin = [0, 0, 0]
    origin[INDEX[normal]] = this.place
    return { origin, across: unit(across), up: [0, 1, 0], normal: unit(normal), at: [0, 0] }
  }

  /** Projects a point in the mesh's frame (x, y, z; m) onto the plane that is shown. Returns its image coordinates and its distance from the plane (m). */
  project({ x, y, z }, { origin, across, up, normal, at } = this.frame) {
    const from = [x - origin[0], y - origin[1], z - origin[2]]
    return { x: at[0] + dot(from, across), y: at[1] + dot(from, up), off: dot(from, normal) }
  }

  /** Returns the point in the plane that is shown, given its image coordinates. */
  unproject(x, y) {
    const { origin, across, up, at } = this.frame
    return [0, 1, 2].map((i) => origin[i] + (x - at[0]) * across[i] + (y - at[1]) * up[i])
  }

  load(scene) {
    this.scene = scene
    this.slicer = new Slicer(scene)
    this.nodes = new Float32Array(scene.nodes)
    discard(this.world)
    this.world.clear()
    this.image = null
    this.frameFan(scene)
    this.range = { from: Infinity, to: -Infinity } // extent of the body along the slice's normal
    for (let i = INDEX[this.plane.normal]; i < scene.nodes.length; i += 3) {
      this.range.from = Math.min(this.range.from, scene.nodes[i])
      this.range.to = Math.max(this.range.to, scene.nodes[i])
    }
    this.addTissue(scene)
    this.dirty = true
  }

  /** Places the probe below the regions of interest, with a fan that covers them. */
  frameFan(scene) {
    const host = hostOf(scene), wanted = new Set(scene.regions.filter((r) => !r.bone && r.group !== host && this.focus(r)).map((r) => r.group)), box = new THREE.Box3(), p = new THREE.Vector3()
    for (let t = 0; t < scene.tets.length; t += 5)
      if (wanted.has(scene.tets[t]) || wanted.size === 0)
        for (let i = 1; i < 5; i++) box.expandByPoint(p.fromArray(scene.nodes, 3 * scene.tets[t + i]))
    const middle = box.getCenter(new THREE.Vector3()), size = box.getSize(new THREE.Vector3())
    if (this.plane.across === 'z') return this.frameRectangle(middle, size, box)
    this.probe = new THREE.Vector2(middle.x, box.min.y - 0.016)
    this.reach = new THREE.Vector2(0.010, size.y + 0.030)
    this.spread = Math.min(1.0, Math.atan2(size.x / 2 + 0.012, size.y / 2 + 0.016))
    const width = 2 * this.reach.y * Math.sin(this.spread) * 1.04, low = this.probe.y + this.reach.x * Math.cos(this.spread) - 0.006, high = this.probe.y + this.reach.y + 0.003
    this.view = { x: middle.x, y: (low + high) / 2, size: Math.max(width, high - low) }
  }

  /** Places the image of a slice that runs along the probe. */
  frameRectangle(middle, size, box) {
    this.probe = new THREE.Vector2(middle.z, box.min.y - 0.016)
    this.reach = new THREE.Vector2(0.006, size.y + 0.030)
    this.spread = size.z / 2 + 0.03
    this.view = { x: middle.z, y: this.probe.y + (this.reach.x + this.reach.y) / 2, size: Math.max(2 * this.spread, this.reach.y) * 1.06 }
  }

  /** Enlarges the view so that it contains these points (across, up; m). */
  include(points) {
    const half = Math.max(this.view.size / 2, ...points.flatMap(([x, y]) => [Math.abs(x - this.view.x), Math.abs(y - this.view.y)]))
    this.view.size = 2 * half
    this.dirty = true
  }

  addTissue(scene) {
    const host = hostOf(scene), fan = { probe: { value: this.probe }, reach: { value: this.reach }, spread: { value: this.spread }, ...this.doses }, defines = { ACROSS: this.plane.across, ISO100: shaded(ISODOSE[0].colour), ISO150: shaded(ISODOSE[1].colour), ISO200: shaded(ISODOSE[2].colour), ...(this.plane.across === 'z' ? { LINEAR: '' } : {}) }
    this.greys = new Map(scene.regions.map((r, i) => [r.group, r.bone ? GREY.bone : r.group === host ? GREY.host : /prostate|gland/i.test(r.organ) ? GREY.gland : GREY.other - 0.05 * (i % 3)]))
    const bone = bitsOfBone(scene)
    this.surfaces = this.slicer.select((inside, outside) => inside !== outside && outside !== OUTSIDE)
    this.bones = this.slicer.select((inside, outside, bits) => (bits & bone) !== 0)
    this.geometry = new THREE.BufferGeometry()
    this.levels = new Filled() // grey level of each vertex
    this.tissue = new THREE.Mesh(this.geometry, new THREE.ShaderMaterial({ defines, vertexShader: VERTEX, fragmentShader: FRAGMENT, transparent: true, depthTest: false, side: THREE.DoubleSide, uniforms: fan }))
    const plane = new THREE.PlaneGeometry(2 * this.view.size, 2 * this.view.size).translate(this.view.x, this.view.y, 0)
    this.flashes = scene.parkingPoses.map(() => new THREE.Mesh(plane,
      new THREE.ShaderMaterial({ defines, vertexShader: SIMPLE_VERTEX, fragmentShader: FLASH, transparent: true, depthTest: false, side: THREE.DoubleSide, blending: THREE.AdditiveBlending,
                                 uniforms: { ...fan, needle: { value: new THREE.Vector2() }, visible: { value: 0 } } })))
    for (const mesh of [this.tissue, ...this.flashes]) mesh.frustumCulled = false
    for (const flash of this.flashes) flash.renderOrder = 2
    this.world.add(this.tissue, ...this.flashes)
  }

  /** Draws the computed image and its isodose lines on a 2D canvas. Without a graphics card, this is much faster than a WebGL texture, because the
   * browser copies whatever WebGL has drawn. */
  drawImage(ink) {
    const { image, look } = this, { width, height, pixel } = image, { at } = this.frame, from = [at[0] + image.left - pixel / 2, at[1] + image.near - pixel / 2]
    if (this.isNew) this.noteImage()
    if (this.isNew || this.painted !== look) this.paint(look)
    this.isNew = false
    const [x, y] = this.toPixel(...from), [right, top] = this.toPixel(from[0] + width * pixel, from[1] + height * pixel)
    ink.save()
    ink.translate(x, y)
    ink.scale((right - x) / width, (top - y) / height)
    ink.drawImage(this.pixels, 0, 0)
    ink.restore()
    this.isolines.draw(ink, this, from, [width * pixel, height * pixel])
  }

  noteImage() {
    this.frames.push(performance.now())
    if (this.frames.length > FRAMES) this.frames.shift()
  }

  /** Converts the image's levels to grey pixels. Levels from 1 up are linear in decibels; level 0 is outside the image. */
  paint(look) {
    const { width, height, levels, floor, step, white } = this.image, { pixels } = this, ink = pixels.getContext('2d')
    this.painted = look
    if (pixels.width !== width || pixels.height !== height || !this.bitmap) {
      Object.assign(pixels, { width, height })
      this.bitmap = ink.createImageData(width, height)
    }
    const shades = new Uint32Array(256), colours = new Uint32Array(this.bitmap.data.buffer)
    for (let level = 1; level < 256; level++) {
      const grey = Math.round(255 * Math.min(Math.max(1 + (floor + (level - 1) * step + look.gain - white) / look.range, 0), 1))
      shades[level] = 0xff000000 | grey << 16 | grey << 8 | grey
    }
    for (let i = 0; i < colours.length; i++) colours[i] = shades[levels[i]]
    ink.putImageData(this.bitmap, 0, 0)
  }

  /** Shows the nodes at `nodes`. `lines` has the points of each needle from base to tip, or null for a needle that is not shown. */
  show(nodes, lines) {
    this.nodes = nodes
    this.lines = lines
    this.dirty = true
  }

  setPlace(z) {
    if (z === this.place) return
    this.place = z
    this.dirty = true
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas
    this.setSize(clientWidth, clientHeight, devicePixelRatio)
  }

  /** `ratio`: pixels of the overlay canvas per pixel of the requested size; `unit`: scale of text and line widths. */
  setSize(width, height, ratio, unit = 1) {
    Object.assign(this, { width, height, unit: ratio * unit, dirty: true })
    this.renderer.setSize(width, height, false)
    this.marks.width = width * ratio
    this.marks.height = height * ratio
  }

  /** Renders at a given size. Returns the canvases from bottom to top, which are valid until this task ends. */
  drawAt(width, height, ratio, unit) {
    this.setSize(width, height, ratio, unit)
    this.render(2)
    return this.simulated ? [this.marks] : [this.canvas, this.marks]
  }

  /** Returns where a needle crosses the slice, or null. Here and below, `x` runs across the image. */
  crossing(line) {
    const points = line?.places ?? [], frame = this.frame
    for (let i = points.length - 1; i > 0; i--) {
      const a = this.project(points[i - 1], frame), b = this.project(points[i], frame)
      if (a.off * b.off <= 0 && a.off !== b.off) {
        const part = a.off / (a.off - b.off)
        return { x: a.x + part * (b.x - a.x), y: a.y + part * (b.y - a.y) }
      }
    }
    return null
  }

  /** Draws if something has changed, or if the last drawing was coarse and `coarse` is false. A new picture waits for its computed image, so that both
   * are drawn at once. */
  draw(coarse) {
    const now = performance.now(), simulated = this.simulated
    if (!this.dirty && (this.coarse === coarse || simulated) || !this.scene || !this.width) return
    this.since ??= now
    if (simulated && !this.isNew && now - this.since < SOON) return
    this.since = null
    this.dirty = false
    this.coarse = coarse
    this.render(coarse ? MOVING : Math.min(devicePixelRatio, 2))
  }

  render(ratio) {
    const simulated = this.simulated
    // a needle lies in a sagittal slice and does not cross it
    const crossings = this.plane.across === 'x' ? (this.lines ?? []).map((line) => this.crossing(line)) : []
    this.aim()
    if (!simulated) this.illustrate(ratio, crossings)
    else if (this.illustrated) this.renderer.clear()
    this.illustrated = !simulated
    this.drawMarks(crossings.filter(Boolean), simulated)
  }

  illustrate(ratio, crossings) {
    if (this.renderer.getPixelRatio() !== ratio) this.renderer.setPixelRatio(ratio)
    this.cutTissue()
    this.flashes.forEach((flash, i) => {
      const { needle, visible } = flash.material.uniforms, crossing = crossings[i]
      visible.value = crossing ? 1 : 0
      flash.visible = Boolean(crossing) || this.flashes.length <= FEW
      if (crossing) needle.value.set(crossing.x, crossing.y)
    })
    this.renderer.render(this.world, this.camera)
  }

  cutTissue() {
    const { slicer, levels, geometry } = this, count = slicer.cut(this.nodes, this.direction, this.place)
    levels.count = 0
    levels.reserve(count)
    for (let v = 0; v < count; v++) levels.array[levels.count++] = this.greys.get(slicer.region.array[v]) ?? GREY.other
    show(geometry, 'position', slicer.place, 3)
    show(geometry, 'rest', slicer.nominal, 3)
    show(geometry, 'grey', levels, 1)
  }

  /** Sets the view along the needle: y is up, and x points to the left. */
  aim() {
    const { width, height } = this, scale = this.view.size / Math.min(width, height)
    this.halfWidth = scale * width / 2
    this.halfHeight = scale * height / 2
    Object.assign(this.camera, { left: this.halfWidth, right: -this.halfWidth, top: this.halfHeight, bottom: -this.halfHeight })
    this.camera.position.set(this.view.x, this.view.y, 0)
    this.camera.updateProjectionMatrix()
  }

  toPixel(x, y) {
    const { width, height } = this.marks
    return [width * (0.5 - (x - this.view.x) / (2 * this.halfWidth)), height * (0.5 - (y - this.view.y) / (2 * this.halfHeight))]
  }

  drawMarks(crossings, simulated) {
    const ink = this.marks.getContext('2d'), ratio = this.unit
    ink.clearRect(0, 0, this.marks.width, this.marks.height)
    if (simulated) this.drawImage(ink)
    if (this.marked) {
      this.drawOutlines(ink, this.scene.nodes, this.surfaces, 'rgba(255,255,255,0.38)', [3 * ratio, 3 * ratio], ratio)
      this.drawOutlines(ink, this.nodes, this.surfaces, '#ff8fa3', [], 1.6 * ratio)
      this.drawOutlines(ink, this.nodes, this.bones, '#e8dfc8', [], 2.5 * ratio)
    }
    this.drawRulers(ink, ratio)
    for (const crossing of this.marked ? crossings : []) {
      const [x, y] = this.toPixel(crossing.x, crossing.y)
      ink.strokeStyle = '#37d0ff'
      ink.lineWidth = 1.2 * ratio
      ink.beginPath()
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { ink.moveTo(x + 7 * ratio * dx, y + 7 * ratio * dy); ink.lineTo(x + 12 * ratio * dx, y + 12 * ratio * dy) }
      ink.stroke()
    }
    ink.fillStyle = '#cfd8e3'
    ink.font = `${11 * ratio}px system-ui, sans-serif`
    ink.textAlign = 'left'
    const { name, normal, seen } = this.plane, place = `${name}, ${normal} = ${(1e3 * this.frame.origin[INDEX[normal]]).toFixed(1)} mm${this.tilt()}`
    ink.fillText(place, 10 * ratio, 18 * ratio)
    const beside = this.marks.width > 30 * ratio + ink.measureText(seen + place).width
    ink.textAlign = beside ? 'right' : 'left'
    ink.fillText(seen, beside ? this.marks.width - 10 * ratio : 10 * ratio, (beside ? 18 : 33) * ratio)
    for (const draw of this.overlays) draw(this, ink)
  }

  /** Describes the tilt of the plane that is shown, or returns '' if there is none. */
  tilt() {
    const degrees = Math.acos(Math.min(1, Math.abs(this.frame.normal[INDEX[this.plane.normal]]))) * 180 / Math.PI
    return degrees > 0.5 ? t('slice.tilted', { angle: degrees.toFixed(0) }) : ''
  }

  drawOutlines(ink, nodes, triangles, colour, dash, width) {
    const frame = this.frame, { array: ends, count } = this.slicer.outline(nodes, frame.normal, dot(frame.origin, frame.normal), triangles)
    const pixel = (i) => { const { x, y } = this.project({ x: ends[i], y: ends[i + 1], z: ends[i + 2] }, frame); return this.toPixel(x, y) }
    ink.strokeStyle = colour
    ink.lineWidth = width
    ink.setLineDash(dash)
    ink.beginPath()
    for (let i = 0; i < count; i += 6) {
      ink.moveTo(...pixel(i))
      ink.lineTo(...pixel(i + 3))
    }
    ink.stroke()
    ink.setLineDash([])
  }

  /** Draws rulers in millimetres along the left and lower edges. */
  drawRulers(ink, ratio) {
    const step = 0.005, { width, height } = this.marks
    ink.strokeStyle = ink.fillStyle = 'rgba(200,212,226,0.55)'
    ink.lineWidth = ratio
    ink.font = `${9 * ratio}px system-ui, sans-serif`
    ink.beginPath()
    for (let k = Math.ceil((this.view.y - this.halfHeight) / step); k * step < this.view.y + this.halfHeight; k++) {
      const y = this.toPixel(0, k * step)[1], long = k % 2 === 0
      ink.moveTo(0, y)
      ink.lineTo((long ? 7 : 4) * ratio, y)
      if (k % 4 === 0 && y > 30 * ratio && y < height - 20 * ratio) { ink.textAlign = 'left'; ink.fillText(`${(1e3 * k * step).toFixed(0)}`, 10 * ratio, y + 3 * ratio) }
    }
    for (let k = Math.ceil((this.view.x - this.halfWidth) / step); k * step < this.view.x + this.halfWidth; k++) {
      const x = this.toPixel(k * step, 0)[0], long = k % 2 === 0
      ink.moveTo(x, height)
      ink.lineTo(x, height - (long ? 7 : 4) * ratio)
      if (k % 4 === 0 && x > 24 * ratio && x < width - 24 * ratio) { ink.textAlign = 'center'; ink.fillText(`${(1e3 * k * step).toFixed(0)}`, x, height - 10 * ratio) }
    }
    ink.stroke()
  }
}
