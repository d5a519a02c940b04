// Numbers for the graphics that change with every picture, in buffers that only grow; and what is shown no more.
import * as THREE from 'three'

/** A list of numbers that grows and is filled anew each time: set `count` to 0, reserve, write. */
export class Filled {
  constructor() { this.array = new Float32Array(3 << 13); this.count = 0 } // whole vertices, also of 3 numbers
  reserve(more) {
    if (this.count + more <= this.array.length) return
    const wider = new Float32Array(2 * (this.count + more))
    wider.set(this.array)
    this.array = wider
  }
}

/** Makes what is `filled` the attribute `name` of a geometry, `size` numbers a vertex, and draws as many vertices. */
export function show(geometry, name, filled, size) {
  if (geometry.getAttribute(name)?.array !== filled.array) {
    geometry.dispose() // the graphics' copies of it
    geometry.setAttribute(name, new THREE.BufferAttribute(filled.array, size).setUsage(THREE.DynamicDrawUsage))
  }
  const attribute = geometry.getAttribute(name)
  attribute.clearUpdateRanges()
  attribute.addUpdateRange(0, filled.count)
  attribute.needsUpdate = true
  geometry.setDrawRange(0, filled.count / size)
}

/** Gives back what the graphics hold of an object and of all that is in it. */
export function discard(object) {
  object.traverse((part) => { for (const held of [part.geometry, part.material, part]) held?.dispose?.() })
}
