// A form with all tissue values that can be changed while the server runs.
import { hasText, said, t } from '../words/words.js'

const element = (id) => document.getElementById(id)
const set = (node, text) => { if (node.textContent !== text) node.textContent = text }
const UNITS = { youngs_modulus: 'Pa', cutting_force: 'N', cutting_viscosity: 'N s/m', spreading_force: 'N', static: 'N/m', kinetic: 'N/m', viscous: 'N s/m²', puncture_force: 'N', stiffness: 'N/m' }

const STEP = 0.1 // part of a value by which a button changes it

export class Tissue {
  constructor(link) {
    Object.assign(this, { link, inputs: new Map(), number: 0, waiting: false })
    element('tissue-button').addEventListener('click', () => this.open())
    element('tissue-close').addEventListener('click', () => element('tissue').close())
    element('tissue-undo').addEventListener('click', () => this.discard())
    element('tissue-form').addEventListener('submit', (event) => {
      event.preventDefault()
      this.apply()
    })
  }

  get available() { return this.inputs.size > 0 }

  open() {
    if (!this.available) return
    this.discard()
    element('tissue').showModal()
  }

  /** Called with each status. A field that the user has edited keeps what was typed. */
  hear({ values, changed }) {
    element('tissue-button').hidden = !values
    if (!values) {
      this.inputs.clear()
      return
    }
    const keys = Object.keys(values)
    if (keys.length !== this.inputs.size || keys.some((key) => !this.inputs.has(key))) this.list(keys)
    for (const [key, field] of this.inputs) {
      const text = values[key] === null ? '.inf' : String(values[key]) // null stands for infinity (bone), which JSON lacks
      if (field.value === field.known) field.value = text
      field.known = text
      field.disabled = values[key] === null
      for (const button of field.steps) button.disabled = field.disabled
    }
    if (!this.waiting || changed?.number !== this.number) return
    this.waiting = false
    set(element('tissue-answer'), changed.done ? t('tissue.done') : t('tissue.refused', { message: said(changed.message) }))
    element('tissue-answer').classList.toggle('refused', !changed.done)
  }

  /** Makes a group of fields for each region, membrane, calcification and guide. */
  list(keys) {
    this.inputs.clear()
    const groups = new Map()
    for (const key of keys) {
      const [, name, property] = /^([^\]]*\])\.(.*)$/.exec(key)
      if (!groups.has(name)) groups.set(name, [])
      groups.get(name).push([key, property])
    }
    element('tissue-values').replaceChildren(...[...groups].map(([name, members]) => {
      const group = document.createElement('fieldset'), legend = document.createElement('legend')
      legend.textContent = name
      group.append(legend, ...members.map(([key, property]) => this.field(key, property)))
      return group
    }))
  }

  /** Returns a row with the field, and buttons for a pointer. */
  field(key, property) {
    const row = document.createElement('div'), label = document.createElement('label'), input = document.createElement('input'), unit = UNITS[property.split('.').pop()] ?? ''
    const name = hasText(`tissue.${property}`) ? t(`tissue.${property}`) : property.replaceAll('_', ' ')
    Object.assign(input, { type: 'text', inputMode: 'decimal', size: 8, autocomplete: 'off', spellcheck: false, name: key, known: '' })
    input.value = input.known
    input.steps = [this.stepButton(key, -STEP, t('tissue.less', { name })), this.stepButton(key, STEP, t('tissue.more', { name }))]
    label.append(`${name}${unit && `, ${unit}`} `, input)
    row.append(label, ...input.steps)
    this.inputs.set(key, input)
    return row
  }

  stepButton(key, part, words) {
    const button = Object.assign(document.createElement('button'), { type: 'button', textContent: part < 0 ? '−' : '+', title: words, tabIndex: -1 })
    button.setAttribute('aria-label', words)
    button.addEventListener('click', () => this.step(key, part))
    return button
  }

  /** Changes a field by a part of its value or, if that is 0, of the largest value of this kind. */
  step(key, part) {
    const field = this.inputs.get(key), value = Number(field.value), kind = key.replace(/^.*\]/, '')
    const alike = [...this.inputs].filter(([other]) => other.endsWith(kind)).map(([, { value: text }]) => Number(text)).filter(Number.isFinite)
    if (Number.isFinite(value)) field.value = String(Math.max(0, Number((value + part * (value || Math.max(...alike) || 1)).toPrecision(3))))
  }

  discard() {
    for (const field of this.inputs.values()) field.value = field.known
    set(element('tissue-answer'), '')
  }

  apply() {
    const lines = [...this.inputs].filter(([, field]) => field.value.trim() !== field.known).map(([key, field]) => `${key}: ${field.value.trim()}`)
    const bytes = new TextEncoder().encode(lines.join('\n')).length
    element('tissue-answer').classList.toggle('refused', lines.length === 0 || bytes > 512)
    if (lines.length === 0) return set(element('tissue-answer'), t('tissue.same'))
    if (bytes > 512) return set(element('tissue-answer'), t('tissue.many'))
    this.number = Math.floor(Math.random() * 0x7fffffff) + 1
    this.waiting = true
    set(element('tissue-answer'), t('tissue.waiting'))
    this.link.change(lines.join('\n'), Number(element('tissue-time').value), this.number)
  }
}
