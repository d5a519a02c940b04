// Draws guides: plates with holes through which needles pass.
import * as THREE from 'three'

const SEGMENTS = 24  // segments in the edge of a hole
const THINNEST = 2e-4 // m, thickness at which to draw a plate that has none

/** Returns a plate that extends one hole spacing beyond the outer holes. Its outline is only illustrative: the server knows nothing but the holes. */
function plate(guide) {
  const half = (count) => (0.5 * (count - 1) + 1) * guide.spacing, width = half(guide.columns), height = half(guide.rows)
  const shape = new THREE.Shape([[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => new THREE.Vector2(x * width, y * height)))
  for (let column = 0; column < guide.columns; column++)
    for (let row = 0; row < guide.rows; row++) {
      const x = (column - 0.5 * (guide.columns - 1)) * guide.spacing, y = (row - 0.5 * (guide.rows - 1)) * guide.spacing
      shape.holes.push(new THREE.Path().absarc(x, y, guide.holeDiameter / 2, 0, 2 * Math.PI, true))
    }
  const geometry = new THREE.ExtrudeGeometry(shape, { depth: Math.max(guide.thickness, THINNEST), bevelEnabled: false, curveSegments: SEGMENTS })
  const axes = [guide.alongColumns, guide.alongRows, guide.normal].map((axis) => new THREE.Vector3(...axis))
  const mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: '#b8c4d0', transparent: true, opacity: 0.45, side: THREE.DoubleSide, depthWrite: false }))
  mesh.applyMatrix4(new THREE.Matrix4().makeBasis(...axes).setPosition(...guide.origin))
  return mesh
}

export function drawGuides(guides) {
  const group = new THREE.Group()
  for (const guide of guides) group.add(plate(guide))
  return group
}
