/* Tests the isodose lines that the page draws over computed ultrasound images. Around a point from which the dose falls linearly, they are circles of known
   radii, even in a tilted plane.
   usage: isolines_test.mjs SOURCE_DIR */
import assert from 'node:assert/strict'
import path from 'node:path'
import { pathToFileURL } from 'node:url'

const { Isolines } = await import(pathToFileURL(path.join(path.resolve(process.argv[2]), 'clients/view/page/src/procedure/isolines.js')))
const COUNT = 41, SPACING = 1e-3, MIDDLE = [0.003, -0.002, 0.05], TOP = 3, RADIUS = 0.016 // m; dose: TOP prescriptions at MIDDLE, 0 at the distance RADIUS
const vector = (array) => ({ value: { toArray: () => array } }), data = new Uint8Array(COUNT ** 3)
for (let x = 0, i = 0; x < COUNT; x++)
  for (let y = 0; y < COUNT; y++)
    for (let z = 0; z < COUNT; z++, i++) data[i] = Math.round(255 * Math.max(0, 1 - SPACING * Math.hypot(x - 20, y - 20, z - 20) / RADIUS))

/** Returns the ends of all line segments by colour, in the mesh's frame. */
function lines(across, up, origin) {
  const found = {}
  let colour
  const slice = {
    unit: 1, frame: { across, up },
    doses: { dose: { value: { image: { data, width: COUNT, height: COUNT, depth: COUNT } } }, doseOrigin: vector(MIDDLE.map((m) => m - 20.5 * SPACING)), doseSize: vector([1, 1, 1].map(() => COUNT * SPACING)), doseTop: { value: TOP } },
    unproject: (x, y) => origin.map((o, a) => o + x * across[a] + y * up[a]), toPixel: (x, y) => [x, y],
  }
  const note = (x, y) => found[colour].push(slice.unproject(x, y)), ink = { set strokeStyle(value) { colour = value; found[colour] = [] }, beginPath() {}, stroke() {}, moveTo: note, lineTo: note }
  new Isolines().draw(ink, slice, [-0.03, -0.03], [0.06, 0.06])
  return Object.values(found)
}

const half = Math.SQRT1_2, OFF = 0.002 // m, distance of the plane from the middle
for (const [across, up, normal] of [[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, 1], [half, half, 0], [-half, half, 0]]]) {
  const circles = lines(across, up, MIDDLE.map((m, a) => m + OFF * normal[a]))
  assert.equal(circles.length, 3)
  circles.forEach((points, i) => {
    const radius = RADIUS * (1 - [1, 1.5, 2][i] / TOP), distances = points.map((p) => Math.hypot(...p.map((x, a) => x - MIDDLE[a])))
    assert(points.length > 40, `${points.length} points`)
    for (const distance of distances) assert(Math.abs(distance - radius) < 0.15 * SPACING, `${distance} ${radius}`) // a step of the stored dose, 1/255, is 0.06
                                                                                                                    // mm
    const angles = points.map((p) => Math.round(8 + 8 / Math.PI * Math.atan2(...[across, up].map((u) => p.reduce((sum, x, a) => sum + (x - MIDDLE[a]) * u[a], 0)))))
    assert.equal(new Set(angles.map((angle) => angle % 16)).size, 16, 'the line is closed')
  })
}
console.log('passed')
