// Draws seeds, planned seeds and the target in the 3D view.
import * as THREE from 'three'
import { PLANNED, SEED, TARGET } from '../colours.js'

const MOST = 256 // TROCAR_MAX_SEEDS
const along = new THREE.Vector3(0, 1, 0), matrix = new THREE.Matrix4(), turn = new THREE.Quaternion(), one = new THREE.Vector3(1, 1, 1)

/** Returns shapes that are drawn over the tissue, which would otherwise hide them. */
function shapes(geometry, colour, opacity) {
  const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshLambertMaterial({ color: colour, emissive: colour, emissiveIntensity: 0.35, depthTest: false, transparent: true, opacity }), MOST)
  mesh.frustumCulled = false
  mesh.renderOrder = 10
  mesh.count = 0
  return mesh
}

function place(mesh, items) {
  mesh.count = Math.min(items.length, MOST)
  items.slice(0, MOST).forEach(({ position, direction }, i) => mesh.setMatrixAt(i, matrix.compose(position, turn.setFromUnitVectors(along, direction), one)))
  mesh.instanceMatrix.needsUpdate = true
}

export class Seeds3D {
  constructor(length) {
    const grain = () => new THREE.CylinderGeometry(0.0008, 0.0008, length, 10) // twice as thick as a real seed, to be visible
    this.seeds = shapes(grain(), SEED, 1)
    this.planned = shapes(grain(), PLANNED, 0.45)
    this.target = shapes(new THREE.TorusGeometry(0.0022, 0.0003, 8, 32).rotateX(Math.PI / 2), TARGET, 0.9)
    this.group = new THREE.Group().add(this.planned, this.seeds, this.target)
  }

  /** Draws `seeds`, as decoded. `planned`: points; `target`: a point or null; `axis`: direction of the needles. */
  show(seeds, planned, target, axis) {
    place(this.seeds, seeds.map(({ position, direction }) => ({ position: new THREE.Vector3(...position), direction: new THREE.Vector3(...direction) })))
    place(this.planned, planned.map((position) => ({ position, direction: axis })))
    place(this.target, target ? [{ position: target, direction: axis }] : [])
  }
}
