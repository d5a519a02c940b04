// What the page can vouch for: whether what it shows is live, and if not, why and how old it is.

export const FRESH = 0.5 // s: what is called live has arrived within this time
const STALL = 0.15       // s of silence that a pause of the page itself may count for: messages wait in its queue meanwhile

/** Time since something arrived, in steps of the page's own running. */
export class Silence {
  constructor() { this.seconds = Infinity }
  end() { this.seconds = 0 }
  pass(dt) { this.seconds += Math.min(dt, STALL) }
}

const seconds = (s) => (s < 10 ? `${s.toFixed(1)} s` : s < 120 ? `${s.toFixed(0)} s` : `${(s / 60).toFixed(0)} min`)

/**
 * `link`: connected, refusal (text, empty: none), silence (s since the last message), pictures (s since the last picture);
 * `status` as trocar-view sends it; `age`: s since the last sample; `behind`: s that a person looks back, null: follows.
 * Returns name, badge and its kind, and for what is not live the banner's title and text, and `age` (s) where the text ends with it.
 */
export function stateOf({ live, link, status, age, behind }) {
  const state = linkState(live, link, status, age)
  if (behind === null || !live) return state
  const trouble = state.title ? ` ${state.title}.` : ''
  return { ...state, name: 'past', badge: state.title ? state.badge : 'past', kind: state.title ? state.kind : 'past', title: 'Past', text: trouble.trim(), age: behind }
}

function linkState(live, { connected, refusal, silence, pictures }, status, age) {
  const bad = (name, badge, title, text) => ({ name, badge, kind: 'bad', title, text, age: null })
  const since = (name, badge, title, otherwise) => (Number.isFinite(age) ? { ...bad(name, badge, title, 'Last heard'), age } : bad(name, badge, title, otherwise))
  if (refusal) return bad('refused', 'refused', 'Refused', refusal)
  if (!connected) return bad('unconnected', 'no connection', 'No connection to trocar-view', 'Is it still running? The page connects again by itself.')
  if (!live) return { name: 'log', badge: 'log', kind: 'calm' }
  if (silence > FRESH) return since('silent', 'stale', 'trocar-view does not answer', '')
  if (!status.alive) return since('server', 'no server', 'No server', 'Start trocar-server with this scene.')
  if (pictures > FRESH) return bad('stale', 'stale', 'No pictures from the server', 'Forces and depth are live, the needle and the tissue are not.')
  return { name: 'live', badge: 'live', kind: 'good' }
}

/** Fills the banner; hidden while all is as it should be. The age is beside the text, so that it is not read out again and again. */
export function showBanner(banner, state) {
  banner.hidden = !state.title
  const [title, text, age, back] = banner.children
  const set = (element, words) => { if (element.textContent !== words) element.textContent = words }
  set(title, state.title ?? '')
  set(text, state.text ?? '')
  set(age, state.title && state.age != null ? `${seconds(state.age)} ago` : '')
  back.hidden = state.name !== 'past'
}
