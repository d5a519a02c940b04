// Draws the tissue with three.js: the translucent body, structures inside it, the cut surface, and the undeformed shape.
import * as THREE from 'three'
import { Filled, show } from './buffers.js'
import { ramp, regionColour } from './colours.js'

export const OUTSIDE = 0xffffffff
const SOLID = { opacity: 1, slant: 0, facets: false, material: { side: THREE.DoubleSide, transparent: false } }
const colour = new THREE.Color(), mixed = new THREE.Color() // scratch

const VERTEX = `
  attribute float moved;
  varying vec3 place; varying vec3 outward; varying float displaced;
  #include <clipping_planes_pars_vertex>
  void main() {
    #include <begin_vertex>
    #include <project_vertex>
    place = mvPosition.xyz;
    outward = normalMatrix * normal;
    displaced = moved;
    #include <clipping_planes_vertex>
  }`

// A material like glass, more opaque at grazing angles and where the tissue is displaced. With FACETS, it is flat-shaded without specular highlights.
const FRAGMENT = `
  uniform vec3 colour; uniform float opacity, slant, shown, range; uniform sampler2D ramp;
  varying vec3 place; varying vec3 outward; varying float displaced;
  #include <clipping_planes_pars_fragment>
  void main() {
    #include <clipping_planes_fragment>
    vec3 eye = normalize(-place);
    #ifdef FACETS
      vec3 n = normalize(cross(dFdx(place), dFdy(place)));
    #else
      vec3 n = normalize(outward);
    #endif
    float aslant = 1.0 - abs(dot(n, eye));
    if (dot(n, eye) < 0.0) n = -n;
    float light = 0.52 + 0.38 * max(dot(n, normalize(vec3(-0.35, 0.8, 0.55))), 0.0) + 0.14 * max(dot(n, normalize(vec3(0.7, -0.2, 0.4))), 0.0);
    vec3 tone = colour;
    float alpha = opacity + slant * aslant * aslant, part = clamp(displaced / range, 0.0, 1.0);
    if (part > 0.02) {
      tone = mix(colour, texture2D(ramp, vec2(part, 0.5)).rgb, shown * smoothstep(0.02, 0.25, part));
      alpha += shown * 0.30 * smoothstep(0.02, 0.6, part);
    }
    tone *= light;
    #ifndef FACETS
      tone += 0.16 * pow(max(dot(reflect(-normalize(vec3(-0.35, 0.8, 0.55)), n), eye), 0.0), 28.0);
    #endif
    gl_FragColor = vec4(tone, min(alpha, 1.0));
    #include <colorspace_fragment>
  }`

function glass(ramp, colour, look) {
  return new THREE.ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, defines: look.facets ? { FACETS: '' } : {}, transparent: true, clipping: true,
    uniforms: { colour: { value: new THREE.Color(colour) }, opacity: { value: look.opacity }, slant: { value: look.slant },
                shown: { value: 1 }, range: { value: 1e-3 }, ramp: { value: ramp } },
    ...look.material,
  })
}

/** Returns the edges of the triangles as pairs of nodes, each edge once. */
function edgesOf(triangles) {
  const seen = new Set(), edges = []
  for (let t = 0; t < triangles.length; t += 3)
    for (let e = 0; e < 3; e++) {
      const a = triangles[t + e], b = triangles[t + (e + 1) % 3], key = a < b ? a * 4194304 + b : b * 4194304 + a
      if (seen.has(key)) continue
      seen.add(key)
      edges.push(a, b)
    }
  return edges
}

/** Returns the group of the region with the most triangles on the outer surface. */
export function hostOf({ triangles }) {
  const faces = new Map()
  for (let t = 0; t < triangles.length; t += 6)
    if (triangles[t + 4] === OUTSIDE) faces.set(triangles[t + 3], (faces.get(triangles[t + 3]) ?? 0) + 1)
  return [...faces].sort((a, b) => b[1] - a[1])[0]?.[0]
}

/** Returns a bit mask of the surfaces that cannot be punctured. */
export const bitsOfBone = ({ membranes }) => membranes.filter(({ bone }) => bone).reduce((bits, { group }) => bits | 1 << group, 0)

export class Anatomy {
  /** `ramp`: texture with the displacement colours; `slicer`: fills the cut; `planes`: active clipping planes of three.js. */
  constructor(scene, ramp, slicer, planes) {
    this.scene = scene
    this.slicer = slicer
    this.surfaces = slicer.select((inside, outside) => inside !== outside)
    this.group = new THREE.Group()
    this.place = new THREE.BufferAttribute(new Float32Array(scene.nodes), 3).setUsage(THREE.DynamicDrawUsage)
    this.moved = new THREE.BufferAttribute(new Float32Array(scene.nodes.length / 3), 1).setUsage(THREE.DynamicDrawUsage)
    this.ramp = ramp
    this.planes = planes
    this.layers = new Map() // name -> objects
    this.smooth = []        // geometries whose normals are recomputed when the nodes move
    this.range = 1e-3       // m, displacement at the top of the colour scale
    this.host = hostOf(scene)
    this.addBody()
    scene.regions.forEach((region, i) => { if (region.group !== this.host) this.addRegion(region, i) })
    scene.membranes.forEach((membrane) => this.addMembrane(membrane))
    this.addCut()
  }

  /** Returns three nodes for each triangle for which `wanted(inside, outside, bits)` is not 0; if it is -1, the triangle is flipped. */
  pick(wanted) {
    const { triangles } = this.scene, picked = []
    for (let t = 0; t < triangles.length; t += 6) {
      const side = wanted(triangles[t + 3], triangles[t + 4], triangles[t + 5])
      if (side) picked.push(triangles[t], triangles[t + (side > 0 ? 1 : 2)], triangles[t + (side > 0 ? 2 : 1)])
    }
    return picked
  }

  geometry(indices, smooth) {
    const geometry = new THREE.BufferGeometry()
    geometry.setAttribute('position', this.place)
    geometry.setAttribute('moved', this.moved)
    geometry.setIndex(indices)
    if (smooth) {
      geometry.computeVertexNormals()
      this.smooth.push(geometry)
    }
    return geometry
  }

  add(layer, object, order) {
    object.renderOrder = order
    object.frustumCulled = false
    this.group.add(object)
    this.layers.set(layer, [...(this.layers.get(layer) ?? []), object])
  }

  mesh(geometry, colour, look) {
    const material = glass(this.ramp, colour, look)
    material.clippingPlanes = this.planes
    return new THREE.Mesh(geometry, material)
  }

  lines(indices, colour, opacity) {
    const material = new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity, depthWrite: false })
    material.clippingPlanes = this.planes
    return new THREE.LineSegments(this.geometry(indices, false), material)
  }

  /** Adds the body, without the bone surfaces at which the tissue ends. */
  addBody() {
    const bone = bitsOfBone(this.scene)
    const outer = this.pick((inside, outside, bits) => (outside === OUTSIDE && !(bits & bone) ? 1 : 0)), geometry = this.geometry(outer, false)
    const look = (side) => ({ opacity: 0.07, slant: 0.16, facets: true, material: { side, depthWrite: false } })
    this.body = [this.mesh(geometry, '#9fb3c8', look(THREE.BackSide)), this.mesh(geometry, '#9fb3c8', look(THREE.FrontSide))]
    this.add('body', this.body[0], 1)
    this.add('body', this.body[1], 20)
    this.add('mesh', this.lines(edgesOf(outer), '#8fa6bd', 0.16), 19)
  }

  addRegion(region, index) {
    const surface = this.pick((inside, outside) => (inside === region.group ? 1 : outside === region.group ? -1 : 0))
    const colour = regionColour(region, index), solid = region.bone
    const look = solid ? SOLID : { opacity: 0.34, slant: 0.5, facets: false, material: { side: THREE.FrontSide, depthWrite: false } }
    const mesh = this.mesh(this.geometry(surface, true), colour, look)
    mesh.material.uniforms.shown.value = solid ? 0 : 0.7
    this.add(region.name, mesh, solid ? 2 : 10)
    if (!solid) this.addRest(region, surface)
  }

  /** Adds the outline of an undeformed region as faint lines. */
  addRest(region, surface) {
    const geometry = new THREE.BufferGeometry()
    geometry.setAttribute('position', new THREE.BufferAttribute(new Float32Array(this.scene.nodes), 3))
    geometry.setIndex(edgesOf(surface))
    const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: '#ffffff', transparent: true, opacity: 0.1, depthWrite: false }))
    lines.material.clippingPlanes = this.planes
    this.add('shape at rest', lines, 11)
  }

  /** Adds bone, named surfaces inside a region, and the edges of named surfaces that bound a region. */
  addMembrane(membrane) {
    const bit = 1 << membrane.group
    if (membrane.bone) this.add(membrane.name, this.mesh(this.geometry(this.pick((inside, outside, bits) => (bits & bit ? -1 : 0)), true), regionColour(membrane), SOLID), 2)
    if (membrane.bone) return
    const inner = this.pick((inside, outside, bits) => (bits & bit && outside !== OUTSIDE ? 1 : 0))
    if (inner.length === 0) return
    const alone = this.pick((inside, outside, bits) => (bits & bit && inside === outside ? 1 : 0))
    if (alone.length) this.add(membrane.name, this.mesh(this.geometry(alone, true), '#d8c27a', { opacity: 0.15, slant: 0.3, facets: false, material: { side: THREE.DoubleSide, depthWrite: false } }), 9)
    this.add(membrane.name, this.lines(edgesOf(inner), '#ffd9df', 0.22), 12)
  }

  /** Adds the cross-section of the tissue in the cutting plane. */
  addCut() {
    this.cutGeometry = new THREE.BufferGeometry()
    this.cutTints = new Filled() // 3 per vertex
    this.cutColours = new Map()
    this.scene.regions.forEach((region, i) => this.cutColours.set(region.group, new THREE.Color(region.group === this.host ? '#7d8fa3' : regionColour(region, i))))
    const material = new THREE.MeshBasicMaterial({ vertexColors: true, side: THREE.DoubleSide, transparent: true, opacity: 0.82,
                                                   polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 })
    this.add('cut', new THREE.Mesh(this.cutGeometry, material), 5)
    const edge = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: '#ffe9ec' }))
    this.cutEdge = edge.geometry
    this.add('cut', edge, 6)
  }

  /** Applies a picture's displacements. Returns the largest one (m). */
  deform(picture) {
    const { nodes } = this.scene, place = this.place.array, moved = this.moved.array
    let largest = 0
    for (let n = 0, i = 0; n < moved.length; n++, i += 3) {
      const x = picture.scale * picture.displacement[i], y = picture.scale * picture.displacement[i + 1], z = picture.scale * picture.displacement[i + 2]
      place[i] = nodes[i] + x
      place[i + 1] = nodes[i + 1] + y
      place[i + 2] = nodes[i + 2] + z
      moved[n] = Math.sqrt(x * x + y * y + z * z)
      largest = Math.max(largest, moved[n])
    }
    this.place.needsUpdate = this.moved.needsUpdate = this.bent = true
    return largest
  }

  /** Recomputes the normals of surfaces that have moved since the last rendering. Done only then, because not every picture is rendered. */
  smoothen() {
    if (this.bent) for (const geometry of this.smooth) geometry.computeVertexNormals()
    this.bent = false
  }

  /** Cuts at normal . x = offset. If `normal` is null, there is no cut. */
  cut(normal, offset) {
    for (const object of this.layers.get('cut')) object.visible = normal !== null
    if (!normal) return
    const { slicer, cutTints } = this, count = slicer.cut(this.place.array, normal, offset)
    cutTints.count = 0
    cutTints.reserve(3 * count)
    for (let v = 0; v < count; v++) this.colourOfCut(v).toArray(cutTints.array, 3 * v)
    cutTints.count = 3 * count
    show(this.cutGeometry, 'color', cutTints, 3)
    show(this.cutGeometry, 'position', slicer.place, 3)
    show(this.cutEdge, 'position', slicer.outline(this.place.array, normal, offset, this.surfaces), 3)
  }

  /** Returns the colour of a vertex of the cut: the region's colour blended with the displacement's. */
  colourOfCut(v) {
    const { place, nominal, region } = this.slicer, i = 3 * v
    const moved = Math.hypot(place.array[i] - nominal.array[i], place.array[i + 1] - nominal.array[i + 1], place.array[i + 2] - nominal.array[i + 2])
    const part = Math.min(moved / this.range, 1)
    colour.setRGB(...ramp(part), THREE.SRGBColorSpace)
    return mixed.copy(this.cutColours.get(region.array[v]) ?? colour).lerp(colour, 0.75 * Math.min(part / 0.25, 1))
  }

  /** Sets the displacement (m) at the top of the colour scale. */
  setRange(range) {
    this.range = range
    for (const mesh of this.group.children) if (mesh.material.uniforms) mesh.material.uniforms.range.value = range
  }

  setTheme(dark) {
    for (const mesh of this.body) mesh.material.uniforms.colour.value.set(dark ? '#9fb3c8' : '#7b8fa6')
    for (const lines of this.layers.get('mesh')) lines.material.color.set(dark ? '#8fa6bd' : '#506479')
    for (const lines of this.layers.get('shape at rest') ?? []) lines.material.color.set(dark ? '#ffffff' : '#30404f')
  }
}
