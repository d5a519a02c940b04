// The page's texts in the user's language. All of them are in en.json and the other files of this folder; the build picks up any file that is added,
// such as fr.json. Organ names, the texts of a task, and the server's messages to its operator are not translated.
import english from './en.json'
import { chooseLanguage, Messages } from './messages.js'

const files = import.meta.glob(['./*.json', '!./en.json'], { import: 'default' })
const codes = ['en', ...Object.keys(files).map((file) => file.slice(2, -5))]
const asked = new URLSearchParams(location.search)

function remembered() {
  try { return localStorage.getItem('language') } catch { return null } // a private window has no storage
}

/** Pictures that trocar-view saves are in English unless the address names another language. */
const wanted = [asked.get('language') ?? (asked.has('picture') ? 'en' : remembered()), ...navigator.languages].filter(Boolean)

async function load(code) {
  if (code === 'en') return new Messages('en', english, english)
  try {
    return new Messages(code, await files[`./${code}.json`](), english)
  } catch (error) {
    console.warn(`The texts in ${code} cannot be loaded; the page is in English.`, error)
    return new Messages('en', english, english)
  }
}

const messages = await load(chooseLanguage(wanted, codes))

export const language = messages.language

/** Returns the text with this key: see Messages.text. */
export const t = (key, values) => messages.text(key, values)
export const said = (message) => messages.said(message)
export const hasText = (key) => messages.has(key)

/** Puts the texts into the page's elements. data-t is the key of an element's text; data-t-title and data-t-label are the keys of its title and
 * aria-label attributes. */
export function fill(root) {
  document.documentElement.lang = messages.language
  for (const node of root.querySelectorAll('[data-t]')) node.textContent = t(node.dataset.t)
  for (const node of root.querySelectorAll('[data-t-title]')) node.title = t(node.dataset.tTitle)
  for (const node of root.querySelectorAll('[data-t-label]')) node.setAttribute('aria-label', t(node.dataset.tLabel))
}

/** Fills the menu of languages, each under its own name for itself. Choosing one reloads the page. */
export async function listLanguages(menu) {
  const names = await Promise.all(codes.map(async (code) => (code === 'en' ? english : await files[`./${code}.json`]().catch(() => ({}))).language ?? code))
  menu.replaceChildren(...codes.map((code, i) => Object.assign(new Option(names[i], code, false, code === messages.language), { lang: code })))
  menu.addEventListener('change', () => {
    try { localStorage.setItem('language', menu.value) } catch { /* in a private window, the language lasts only in the address */ }
    const address = new URL(location.href)
    address.searchParams.set('language', menu.value)
    location.replace(address)
  })
}

fill(document)
