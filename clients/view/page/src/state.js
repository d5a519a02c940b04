// The state of the display: whether it is live and, if not, why not and how old the data are.
import { t } from './words/words.js'

export const FRESH = 0.5 // s, age up to which data count as live
const STALL = 0.15       // s; if the page itself was paused, for example while messages were queuing, no more than this counts as silence

/** Measures the time since something last arrived, counting only time in which the page is running. */
export class Silence {
  constructor() { this.seconds = Infinity }
  end() { this.seconds = 0 }
  pass(dt) { this.seconds += Math.min(dt, STALL) }
}

const seconds = (s) => (s < 10 ? `${s.toFixed(1)} s` : s < 120 ? `${s.toFixed(0)} s` : `${(s / 60).toFixed(0)} min`)

/** `link`: connected, refusal (text, empty: none), silence (s since the last message), pictures (s since the last picture). `status`: as sent by
 * trocar-view. `age`: s since the last sample. `behind`: s by which the displayed time lags behind, null if live. Returns name, badge and the badge's
 * kind. If the display is not live, also returns title and text of the banner, and `age` (s) if the text ends with it. */
export function stateOf({ live, link, status, age, behind }) {
  const state = linkState(live, link, status, age)
  if (behind === null || !live) return state
  const trouble = state.title ? ` ${state.title}.` : ''
  return { ...state, name: 'past', badge: state.title ? state.badge : t('state.past'), kind: state.title ? state.kind : 'past', title: t('state.past.title'), text: trouble.trim(), age: behind }
}

function linkState(live, { connected, refusal, silence, pictures }, status, age) {
  const bad = (name, badge, title, text) => ({ name, badge, kind: 'bad', title, text, age: null })
  const since = (name, badge, title, otherwise) => (Number.isFinite(age) ? { ...bad(name, badge, title, t('state.last')), age } : bad(name, badge, title, otherwise))
  if (refusal) return bad('refused', t('state.refused'), t('state.refused.title'), refusal)
  if (!connected) return bad('unconnected', t('state.unconnected'), t('state.unconnected.title'), t('state.unconnected.text'))
  if (!live) return { name: 'log', badge: t('state.log'), kind: 'calm' }
  if (silence > FRESH) return since('silent', t('state.silent'), t('state.silent.title'), '')
  if (!status.alive) return since('server', t('state.server'), t('state.server.title'), t('state.server.text'))
  if (pictures > FRESH) return bad('stale', t('state.silent'), t('state.stale.title'), t('state.stale.text'))
  return { name: 'live', badge: t('state.live'), kind: 'good' }
}

/** Fills the banner, which is hidden if all is well. The age is an element of its own, so that screen readers do not keep repeating it. */
export function showBanner(banner, state) {
  banner.hidden = !state.title
  const [title, text, age, back] = banner.children
  const set = (element, words) => { if (element.textContent !== words) element.textContent = words }
  set(title, state.title ?? '')
  set(text, state.text ?? '')
  set(age, state.title && state.age != null ? t('state.ago', { age: seconds(state.age) }) : '')
  back.hidden = state.name !== 'past'
}
