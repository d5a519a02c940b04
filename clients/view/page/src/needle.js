// Draws a bent needle with its hub and its contacts.
import * as THREE from 'three'
import { CONTACT, GUIDED } from './colours.js'
import { CONTACT_NUMBERS, GUIDE, TIP } from './decode.js'

const RINGS = 180, SIDES = 14
const BEVEL = 4          // length of the bevel, in needle diameters
const MARK = 0.01        // m, between depth marks on the shaft
const MAX_CONTACTS = 81 // TROCAR_MAX_POINTS
const ARROW_HEAD = 0.003 // m

export const FORCE_SCALE = 0.04 // m, length of a force arrow per N

/** Returns points and tangents at equal steps along the centreline, by interpolation. */
function trace(joints, count) {
  const points = []
  for (let j = 0; j < joints.length; j += 3) points.push(new THREE.Vector3(joints[j], joints[j + 1], joints[j + 2]))
  const curve = new THREE.CatmullRomCurve3(points, false, 'centripetal')
  const places = [], tangents = []
  for (let i = 0; i < count; i++) {
    places.push(curve.getPoint(i / (count - 1)))
    tangents.push(curve.getTangent(i / (count - 1)))
  }
  return { places, tangents }
}

/** Returns instances of a shape, one per contact. */
function instances(geometry) {
  const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial(), MAX_CONTACTS)
  mesh.frustumCulled = false
  mesh.count = 0
  mesh.setColorAt(0, new THREE.Color())
  return mesh
}

export class Needle {
  /** `hub`: colour of the hub. */
  constructor(scene, hub) {
    this.length = scene.needle.length
    this.radius = scene.needle.diameter / 2
    this.tipColour = '#ffffff'
    this.group = new THREE.Group()
    this.body = new THREE.Group()
    this.group.add(this.body)
    this.addShaft()
    this.addHub(hub)
    this.addContacts()
  }

  addShaft() {
    const geometry = new THREE.BufferGeometry(), count = RINGS * SIDES + 1
    this.place = new THREE.BufferAttribute(new Float32Array(3 * count), 3).setUsage(THREE.DynamicDrawUsage)
    this.normal = new THREE.BufferAttribute(new Float32Array(3 * count), 3).setUsage(THREE.DynamicDrawUsage)
    const colours = new Float32Array(3 * count), indices = []
    for (let ring = 0; ring < RINGS; ring++) {
      const fromTip = this.length * (1 - ring / (RINGS - 1)), dark = fromTip > 0.004 && (fromTip + 0.0006) % MARK < 0.0012
      for (let side = 0; side < SIDES; side++) colours.fill(dark ? 0.2 : 0.86, 3 * (ring * SIDES + side), 3 * (ring * SIDES + side + 1))
      for (let side = 0; side < SIDES && ring < RINGS - 1; side++) {
        const a = ring * SIDES + side, b = ring * SIDES + (side + 1) % SIDES
        indices.push(a, a + SIDES, b, b, a + SIDES, b + SIDES)
      }
    }
    for (let side = 0; side < SIDES; side++) indices.push((RINGS - 1) * SIDES + side, count - 1, (RINGS - 1) * SIDES + (side + 1) % SIDES)
    geometry.setAttribute('position', this.place)
    geometry.setAttribute('normal', this.normal)
    geometry.setAttribute('color', new THREE.BufferAttribute(colours, 3))
    geometry.setIndex(indices)
    const shaft = new THREE.Mesh(geometry, new THREE.MeshPhongMaterial({ vertexColors: true, specular: '#ffffff', shininess: 60 }))
    shaft.frustumCulled = false
    this.body.add(shaft)
  }

  addHub(colour) {
    const body = new THREE.CylinderGeometry(0.0045, 0.0022, 0.022, 24).rotateX(-Math.PI / 2).translate(0, 0, -0.011)
    const mark = new THREE.BoxGeometry(0.0016, 0.0022, 0.02).translate(0, 0.0042, -0.011) // marks the bevel's side of the hub
    this.hub = new THREE.Group()
    this.hub.add(new THREE.Mesh(body, new THREE.MeshPhongMaterial({ color: colour, specular: '#88bbee', shininess: 40 })))
    this.hub.add(new THREE.Mesh(mark, new THREE.MeshPhongMaterial({ color: '#f4d35e' })))
    this.body.add(this.hub)
  }

  addContacts() {
    this.dots = instances(new THREE.SphereGeometry(1, 16, 12))
    this.stems = instances(new THREE.CylinderGeometry(0.00025, 0.00025, 1, 8).translate(0, 0.5, 0))
    this.heads = instances(new THREE.ConeGeometry(0.0008, ARROW_HEAD, 12).translate(0, -ARROW_HEAD / 2, 0))
    this.arrows = new THREE.Group().add(this.stems, this.heads)
    this.group.add(this.dots, this.arrows)
  }

  /** Draws `shape`, a needle from a picture, or hides the needle if `shape` is undefined. Sets `line` to the points and tangents from base to tip. */
  show(shape) {
    this.group.visible = Boolean(shape)
    this.line = this.tip = null
    if (!shape) return
    const base = new THREE.Quaternion(shape.orientation[1], shape.orientation[2], shape.orientation[3], shape.orientation[0])
    this.line = trace(shape.joints, RINGS)
    this.bend(this.line, base)
    this.hub.position.fromArray(shape.joints)
    this.hub.quaternion.copy(base)
    this.touch(shape.contacts)
    this.tip = this.line.places.at(-1)
  }

  /** Places rings around the centreline, in a frame that does not twist. The tip is bevelled. */
  bend({ places, tangents }, base) {
    const up = new THREE.Vector3(0, 1, 0).applyQuaternion(base), side = new THREE.Vector3(), out = new THREE.Vector3(), { radius } = this
    const place = this.place.array, normal = this.normal.array
    for (let ring = 0; ring < RINGS; ring++) {
      const t = tangents[ring], centre = places[ring]
      up.addScaledVector(t, -up.dot(t)).normalize()
      side.crossVectors(up, t)
      const fromTip = this.length * (1 - ring / (RINGS - 1)), top = Math.min(radius, radius * (2 * fromTip / (2 * BEVEL * radius) - 1))
      for (let s = 0; s < SIDES; s++) {
        const angle = 2 * Math.PI * s / SIDES, x = radius * Math.sin(angle), y = Math.min(radius * Math.cos(angle), top), i = 3 * (ring * SIDES + s)
        out.copy(side).multiplyScalar(x).addScaledVector(up, y)
        centre.clone().add(out).toArray(place, i)
        out.normalize().toArray(normal, i)
      }
    }
    places[RINGS - 1].clone().addScaledVector(up, -radius).toArray(place, 3 * RINGS * SIDES)
    tangents[RINGS - 1].toArray(normal, 3 * RINGS * SIDES)
    this.place.needsUpdate = this.normal.needsUpdate = true
  }

  /** Draws a dot for each contact, and an arrow for the force on the tissue or guide. */
  touch(contacts) {
    const count = contacts.length / CONTACT_NUMBERS, matrix = new THREE.Matrix4(), turn = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0)
    const place = new THREE.Vector3(), force = new THREE.Vector3(), size = new THREE.Vector3(), colour = new THREE.Color()
    for (let i = 0; i < count; i++) {
      const at = CONTACT_NUMBERS * i, [state, kind] = contacts.subarray(at + 7, at + 9), tip = kind === TIP
      place.fromArray(contacts, at)
      force.fromArray(contacts, at + 3)
      const length = FORCE_SCALE * force.length(), head = Math.min(1, length / ARROW_HEAD)
      turn.setFromUnitVectors(up, force.clone().normalize())
      this.dots.setMatrixAt(i, matrix.makeScale(...Array(3).fill(tip ? 0.0014 : 0.001)).setPosition(place))
      this.stems.setMatrixAt(i, matrix.compose(place, turn, size.set(1, Math.max(length - 0.5 * head * ARROW_HEAD, 1e-6), 1)))
      this.heads.setMatrixAt(i, matrix.compose(place.addScaledVector(force, FORCE_SCALE), turn, size.setScalar(Math.max(head, 1e-6))))
      for (const part of [this.dots, this.stems, this.heads]) part.setColorAt(i, colour.set(tip ? this.tipColour : kind === GUIDE ? GUIDED : CONTACT[state]))
    }
    for (const part of [this.dots, this.stems, this.heads]) {
      part.count = count
      part.instanceMatrix.needsUpdate = part.instanceColor.needsUpdate = true
    }
  }
}
