// Growing buffers for vertex data that changes with every picture, and a function that frees graphics resources.
import * as THREE from 'three'

/** A growing array that is refilled each time: set `count` to 0, reserve space, and write. */
export class Filled {
  constructor() { this.array = new Float32Array(3 << 13); this.count = 0 } // the size must be a multiple of 3
  reserve(more) {
    if (this.count + more <= this.array.length) return
    const wider = new Float32Array(2 * (this.count + more))
    wider.set(this.array)
    this.array = wider
  }
}

/** Makes `filled` the attribute `name` of a geometry, with `size` numbers per vertex, and sets the draw range. */
export function show(geometry, name, filled, size) {
  if (geometry.getAttribute(name)?.array !== filled.array) {
    geometry.dispose() // frees its GPU buffers
    geometry.setAttribute(name, new THREE.BufferAttribute(filled.array, size).setUsage(THREE.DynamicDrawUsage))
  }
  const attribute = geometry.getAttribute(name)
  attribute.clearUpdateRanges()
  attribute.addUpdateRange(0, filled.count)
  attribute.needsUpdate = true
  geometry.setDrawRange(0, filled.count / size)
}

/** Frees the GPU resources of an object and its children. */
export function discard(object) {
  object.traverse((part) => { for (const held of [part.geometry, part.material, part]) held?.dispose?.() })
}
