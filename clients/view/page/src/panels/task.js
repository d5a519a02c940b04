// A trainee's task: its description, start and elapsed time, and the report that trocar-score makes from the recording.
import { language, said, t } from '../words/words.js'

const element = (id) => document.getElementById(id)
const set = (node, text) => { if (node.textContent !== text) node.textContent = text }
const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, '0')}`
const FILES = ['html', 'json', 'csv', 'log']

export class Task {
  constructor(link, procedure) {
    Object.assign(this, { link, procedure, description: null, shown: '', asked: null, trouble: '' })
    element('task-button').addEventListener('click', () => element('task').showModal())
    element('task-close').addEventListener('click', () => element('task').close())
    element('task-start').addEventListener('click', () => link.startTask())
    element('task-finish').addEventListener('click', () => link.finishTask(language))
    element('task-print').addEventListener('click', () => print())
    this.report = element('task-report').attachShadow({ mode: 'open' })
  }

  /** Called when a scene has been loaded. Shows the task's targets. */
  load(scene) {
    this.scene = scene
    this.showTargets()
  }

  /** Called with the member "task" of each status, which is undefined if there is no task. `elsewhere`: another page drives the needle; trocar-view then ignores
   * this page's start and end. */
  hear(status, elsewhere) {
    if (!status) return
    element('task-button').hidden = false
    if (!this.asked) this.asked = this.fetchTask()
    const { state, elapsed, clears, report, message } = status, running = state === 'running', startable = state === 'ready' || state === 'scored'
    set(element('task-button'), state === 'ready' || state === 'clearing' ? t('task.button') : t('task.button.time', { time: clock(elapsed) }))
    element('task-button').classList.toggle('running', running)
    element('task-start').hidden = !startable
    for (const id of ['task-start', 'task-finish']) element(id).disabled = elsewhere
    set(element('task-start'), t(state === 'ready' ? 'task.start' : 'task.again'))
    element('task-finish').hidden = !running
    const words = { clearing: t('task.clearing'), scoring: t('task.scoring'), running: t('task.running', { time: clock(elapsed) }) }[state]
    set(element('task-message'), said(message) || (elsewhere ? t('task.elsewhere') : '') || words || this.trouble || (clears ? t('task.clears') : ''))
    if (running && this.state !== 'running' && this.state) {
      this.procedure.beginTask()
      element('task').close() // the trainee needs the images
    }
    this.procedure.judged = running
    this.state = state
    if (report !== this.shown) this.showReport(report)
  }

  async fetchTask() {
    const answer = await fetch('task/task.json')
    if (!answer.ok) return
    this.description = await answer.json()
    const { texts } = this.description, { title, text, criteria, hints } = texts[language] ?? texts.en
    set(element('task-title'), title)
    set(element('task-text'), text)
    const item = (words) => Object.assign(document.createElement('li'), { textContent: words })
    element('task-criteria').replaceChildren(...criteria.map(({ words, limit, source }) => item(`${words}: ${limit} (${source})`)))
    element('task-hints').hidden = hints.length === 0
    element('task-hints').lastElementChild.replaceChildren(...hints.map(item))
    this.showTargets()
    if (this.state === 'ready') element('task').showModal()
  }

  showTargets() {
    const { procedure, scene, description } = this
    if (!scene || !description) return
    if (description.targets.length) procedure.hearTargets(description.targets)
  }

  async showReport(run) {
    this.shown = run
    const answer = run ? await fetch(`runs/${run}.html`) : null, found = Boolean(answer?.ok)
    for (const file of FILES) {
      element(`task-${file}`).hidden = !found
      element(`task-${file}`).href = `runs/${run}.${file}`
    }
    element('task-print').hidden = !found
    element('task').classList.toggle('reported', found)
    this.trouble = run && !found ? t('task.lost') : ''
    if (!found) return this.report.replaceChildren()
    const text = await answer.text(), style = /<style>([^]*?)<\/style>/
    const sheet = new CSSStyleSheet(), page = new DOMParser().parseFromString(text.replace(style, ''), 'text/html')
    sheet.replaceSync(style.exec(text)[1]) // the page's security policy forbids style elements
    this.report.adoptedStyleSheets = [sheet]
    element('task-report').lang = page.documentElement.lang
    this.report.replaceChildren(page.querySelector('main'))
    if (!element('task').open) element('task').showModal()
  }
}
