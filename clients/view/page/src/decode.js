// Decodes messages from trocar-view: see clients/view/stream/wire_format.h.

const SCENE = 1, PICTURE = 2, SAMPLES = 3, STATUS = 4, SEEDS = 5, REPLY = 6, DOSE = 7, PLAN = 8, ULTRASOUND = 9
const SAMPLE_BYTES = 64
const NEEDLE_BYTES = 48 // bytes in a needle's record before its joints
const PROBE_BYTES = 64
export const CONTACT_NUMBERS = 9 // numbers per contact
export const TRACK_NUMBERS = 6 // numbers per point of a track
export const TIP = 1, GUIDE = 2 // kinds of contact
const names = { [SCENE]: 'scene', [PICTURE]: 'picture', [SAMPLES]: 'samples', [STATUS]: 'status', [SEEDS]: 'seeds', [REPLY]: 'reply', [DOSE]: 'dose', [PLAN]: 'plan', [ULTRASOUND]: 'ultrasound' }
const decoders = { [SCENE]: decodeScene, [PICTURE]: decodePicture, [SAMPLES]: decodeSamples, [STATUS]: decodeText,
                   [SEEDS]: decodeSeeds, [REPLY]: decodeText, [DOSE]: decodeDose, [PLAN]: decodeText, [ULTRASOUND]: decodeUltrasound }

/** Yields each section of a message as [name, decoded content]. */
export function* sections(message) {
  const head = new DataView(message)
  for (let at = 0; at + 8 <= message.byteLength;) {
    const kind = head.getUint32(at, true), length = head.getUint32(at + 4, true)
    if (decoders[kind]) yield [names[kind], decoders[kind](message, at + 8, length)]
    at += 8 + padded(length)
  }
}

const padded = (length) => Math.ceil(length / 8) * 8

function decodeText(message, at, length) {
  return JSON.parse(new TextDecoder().decode(new Uint8Array(message, at, length)))
}

/** Returns `nodes`: 3 numbers per node (m); `tets`: region group and 4 nodes; `triangles`: 3 nodes, group inside, group outside, surface bits. */
function decodeScene(message, start, length) {
  const text = new DataView(message).getUint32(start, true)
  const scene = decodeText(message, start + 8, text)
  let at = start + 8 + padded(text)
  const take = (type, count) => {
    const array = new type(message.slice(at, at + 4 * count))
    at += 4 * count
    return array
  }
  const tets = scene.tets
  scene.nodes = take(Float32Array, 3 * scene.nodes)
  scene.tets = take(Uint32Array, 5 * tets)
  scene.triangles = take(Uint32Array, (start + length - at) / 4)
  return scene
}

/** Returns `needles`, by index, where a needle that has not been held yet is missing; `probe`, null if there is none; and `displacement`, in units of
 * `scale` (m). */
function decodePicture(message, at, length) {
  const body = message.slice(at, at + length), head = new DataView(body), needles = [], probe = head.getUint32(28, true) ? decodeProbe(body, 32) : null
  let place = 32 + (probe ? PROBE_BYTES : 0)
  for (let left = head.getUint32(20, true); left > 0; left--) {
    const joints = head.getUint32(place + 28, true), contacts = head.getUint32(place + 32, true), points = head.getUint32(place + 36, true)
    const tracks = place + NEEDLE_BYTES + 12 * joints + 4 * CONTACT_NUMBERS * contacts
    needles[head.getUint32(place + 24, true)] = { ...decodeNeedle(body, place, joints, contacts), tracks: decodeTracks(body, tracks, points) }
    place = tracks + 4 * TRACK_NUMBERS * points
  }
  return {
    time: head.getFloat64(0, true), tick: head.getFloat64(8, true), scale: head.getFloat32(16, true), needles, probe,
    displacement: new Int16Array(body, place, 3 * head.getUint32(24, true)),
    bytes: length,
  }
}

/** Returns the probe: the pose of its base (m; w x y z), the force (N) on the hand that holds it, and `stopped`, which is true if the tissue stopped it
 * short of its last pose. */
function decodeProbe(body, at) {
  const numbers = new Float32Array(body, at, 13), counts = new DataView(body)
  return { position: numbers.slice(0, 3), orientation: numbers.slice(3, 7), force: numbers.slice(7, 10), torque: numbers.slice(10, 13), contacts: counts.getUint32(at + 52, true), stopped: counts.getUint32(at + 56, true) !== 0 }
}

/** Returns `joints`: 3 numbers per joint (m); `contacts`: CONTACT_NUMBERS per contact, which are position (m), force on tissue or guide (N), arc length
 * (m), state and kind; `tipLead`: roll of the tip minus roll of the base (rad). */
function decodeNeedle(body, at, joints, contacts) {
  const head = new DataView(body, at, NEEDLE_BYTES)
  return {
    poseTime: head.getFloat64(0, true), orientation: [0, 1, 2, 3].map((i) => head.getFloat32(8 + 4 * i, true)),
    tipLead: head.getFloat32(40, true),
    joints: new Float32Array(body, at + NEEDLE_BYTES, 3 * joints),
    contacts: new Float32Array(body, at + NEEDLE_BYTES + 12 * joints, CONTACT_NUMBERS * contacts),
  }
}

/** Returns the points of tracks, TRACK_NUMBERS per point. In `places`, the first three numbers of a point are its undeformed position (m). `kinds`
 * views the same memory as integers: numbers four to six of a point are its tetrahedron, its track, and the membrane punctured there or -1. */
function decodeTracks(body, at, points) {
  return { places: new Float32Array(body, at, TRACK_NUMBERS * points), kinds: new Int32Array(body, at, TRACK_NUMBERS * points) }
}

function decodeSamples(message, at, length) {
  const view = new DataView(message, at, length), samples = []
  for (let i = 0; i + SAMPLE_BYTES <= length; i += SAMPLE_BYTES) {
    const number = (k) => view.getFloat32(i + 8 + 4 * k, true)
    samples.push({
      time: view.getFloat64(i, true),
      values: [number(0), number(1), number(2), number(3), number(4), number(5), number(6), number(7), number(8), number(9), number(10)],
      events: view.getUint32(i + 52, true), membrane: view.getInt32(i + 56, true), needle: view.getInt32(i + 60, true),
    })
  }
  return samples
}

/** Returns `pending`, the number of seeds still in each needle, and `seeds`. A seed has its centre (m) and the unit direction to its distal end, both
 * in the deformed and in the undeformed tissue; the needle that left it; its guide and hole (-1 if none); and its index in the strand. */
function decodeSeeds(message, at) {
  const head = new DataView(message, at), needles = head.getInt32(0, true), count = head.getInt32(4, true)
  const pending = Array.from({ length: needles }, (_, i) => head.getInt32(8 + 4 * i, true))
  const seeds = Array.from({ length: count }, (_, i) => {
    const start = at + 8 + 4 * needles + 64 * i, places = new Float32Array(message.slice(start, start + 48)), numbers = new Int32Array(message.slice(start + 48, start + 64))
    return { position: places.subarray(0, 3), direction: places.subarray(3, 6), restPosition: places.subarray(6, 9), restDirection: places.subarray(9, 12),
             needle: numbers[0], guide: numbers[1], hole: numbers[2], strand: numbers[3] }
  })
  return { pending, seeds }
}

/** Returns the dose statistics and `levels`, one byte per voxel (z varies fastest). 255 means `top` times the prescription, or more. */
function decodeDose(message, at, length) {
  const text = new DataView(message).getUint32(at, true), start = at + 8 + padded(text)
  return { ...decodeText(message, at + 8, text), levels: new Uint8Array(message.slice(start, at + length)) }
}

/** Returns ultrasound images. Each has its plane (unit vectors, m), its raster and `levels`, one byte per pixel, row by row away from the probe. */
function decodeUltrasound(message, at, length) {
  const text = new DataView(message).getUint32(at, true), { images, ...scale } = decodeText(message, at + 8, text)
  let start = at + 8 + padded(text)
  return images.map((image) => {
    const levels = new Uint8Array(message, start, image.width * image.height)
    start += levels.length
    return { ...image, ...scale, levels }
  })
}
