/* Tests the page's message files, and that the page's source contains no other texts. language_test.mjs tests the same for the running page.
   usage: words_test.mjs SOURCE_DIR */
import assert from 'node:assert/strict'
import { readdir, readFile } from 'node:fs/promises'
import { createRequire } from 'node:module'
import path from 'node:path'
import { pathToFileURL } from 'node:url'

const page = path.join(path.resolve(process.argv[2]), 'clients/view/page'), source = path.join(page, 'src'), words = path.join(source, 'words')
const { chooseLanguage, Messages } = await import(pathToFileURL(path.join(words, 'messages.js')))
const codes = (await readdir(words)).filter((name) => name.endsWith('.json')).map((name) => name.slice(0, -5))
const files = Object.fromEntries(await Promise.all(codes.map(async (code) => [code, JSON.parse(await readFile(path.join(words, `${code}.json`), 'utf8'))])))
const read = (file) => readFile(path.join(source, file), 'utf8')
const scripts = (await readdir(source, { recursive: true })).filter((name) => name.endsWith('.js'))

const check = (name, body) => Promise.resolve(body()).then(() => console.log(`ok ${name}`))
const placesOf = (message) => (typeof message === 'string' ? [message] : Object.values(message)).map((text) => [...new Set(text.match(/\{\w+\}/g) ?? [])].sort().join())

await check('there are English and another language', () => assert(codes.includes('en') && codes.length > 1, `${codes}`))

await check('all languages have the same keys, places and forms', () => {
  for (const code of codes) {
    assert.deepEqual(Object.keys(files[code]), Object.keys(files.en), code)
    const forms = new Intl.PluralRules(code).resolvedOptions().pluralCategories.slice().sort()
    for (const [key, message] of Object.entries(files[code])) {
      assert.equal(typeof message, typeof files.en[key], `${code}: ${key}`)
      if (typeof message === 'object') assert.deepEqual(Object.keys(message).sort(), forms, `${code}: ${key}`)
      const [mine, english] = [message, files.en[key]].map((text) => new Set(placesOf(text).flatMap((places) => places.split(','))))
      assert.deepEqual([...mine].filter(Boolean).sort(), [...english].filter(Boolean).sort(), `${code}: places of ${key}`)
      for (const text of typeof message === 'string' ? [message] : Object.values(message)) assert(text.trim() !== '', `${code}: ${key} is empty`)
    }
  }
})

await check('a text that a language lacks is English, with English plurals', () => {
  const english = { seeds: { one: '{count} seed', other: '{count} seeds' }, stop: 'Stop', both: 'both' }
  const polish = new Messages('pl', { seeds: { one: '{count} ziarno', few: '{count} ziarna', many: '{count} ziaren', other: '{count} ziarna' }, both: 'oba' }, english)
  assert.deepEqual([1, 3, 5].map((count) => polish.text('seeds', { count })), ['1 ziarno', '3 ziarna', '5 ziaren'])
  assert.equal(polish.text('stop'), 'Stop')
  assert.equal(polish.text('both'), 'oba')
  assert.equal(polish.text('unknown.key'), 'unknown.key')
  assert(polish.has('stop') && !polish.has('unknown.key'))
  assert.deepEqual([1, 5].map((count) => new Messages('pl', {}, english).text('seeds', { count })), ['1 seed', '5 seeds'])
})

/* ---- what programs say ---- */

const root = path.resolve(process.argv[2]), sources = async (files) => (await Promise.all(files.map((file) => readFile(path.join(root, file), 'utf8')))).join('\n')
const german = new Messages('de', files.de, files.en), said = Object.entries(files.en).filter(([key]) => key.startsWith('said.'))
// sources of trocar-view, the server and the library that contain messages shown to trainees
const SPEAKERS = ['clients/view/hand/pilot.c', 'clients/view/training/training.c', 'server/haptic.c', 'server/io.c', 'server/telemetry.c', 'server/intake/pose_arbiter.c', 'server/intake/probe_arbiter.c',
                  'server/intake/changes.c', 'core/api/api_seeds.c', 'core/api/api_sim.c', 'core/api/api_change.c', 'core/api/worker_resting.c', 'core/resting/resting_needle.c']

/** Returns the strings of a C source, with {} for each conversion of printf; adjacent strings are joined. */
function stringsOf(source) {
  const joined = source.replace(/"\s*PRI[diux]64\b\s*(")?/g, (all, more) => (more ? 'd' : 'd"')).replace(/([^\\])"\s*"/g, '$1')
  return [...joined.matchAll(/"((?:[^"\\]|\\.)*)"/g)].map(([, text]) => text.replace(/\\"/g, '"').replace(/%[-+0#]*\d*(?:\.[\d*]+)?(?:ll|l|z)?[diuxgefs]/g, '{}'))
}

await check('the texts of programs are those of their sources', async () => {
  assert.deepEqual(stringsOf('say("a %.1f mm", "b" "c\\"", "session %" PRId64 " and %" PRId64, n)'), ['a {} mm', 'bc"', 'session {} and {}'])
  const spoken = new Set(stringsOf(await sources(SPEAKERS)))
  assert(said.length > 40)
  for (const [key, english] of said) assert(spoken.has(english.replace(/\{\w+\}/g, '{}')), `no program says ${key}: ${english}`)
})

await check('each refusal of a seed or of a needle is translated', async () => {
  const refused = [...(await sources(['core/api/api_seeds.c', 'server/haptic.c'])).matchAll(/fail\(why, \w+, ("(?:[^"\\]|\\.)*")/g)].map(([, literal]) => stringsOf(literal)[0])
  assert(refused.length >= 10, `${refused.length}`)
  for (const text of refused) assert.notEqual(german.said(text.replaceAll('{}', '3')), text.replaceAll('{}', '3'))
})

await check('what a program says is translated, and its reason with it', () => {
  for (const [key, english] of said) {
    const places = [...english.matchAll(/\{(\w+)\}/g)].map(([, name]) => name), values = Object.fromEntries(places.map((name, i) => [name, `${i + 3}`]))
    const fill = (text) => text.replace(/\{(\w+)\}/g, (place, name) => values[name])
    assert.equal(german.said(fill(english)), fill(files.de[key]), key)
  }
  assert.equal(german.said('needle 3 is made of wood'), 'needle 3 is made of wood')
  assert.equal(german.said('command 4 of session 77 refused for needle 0: the tip of needle 0 is outside the tissue: seeds can be dropped only in the tissue'),
               'Befehl 4 der Sitzung 77 für Nadel 0 abgelehnt: die Spitze der Nadel 0 ist außerhalb des Gewebes: Seeds können nur im Gewebe abgelegt werden')
})

await check('the language is the first wanted one of which there is a file', () => {
  assert.equal(chooseLanguage(['fr-CH', 'de-CH', 'en'], ['en', 'de']), 'de')
  assert.equal(chooseLanguage(['en-GB', 'de'], ['en', 'de']), 'en')
  assert.equal(chooseLanguage(['pt-BR'], ['en', 'pt', 'pt-br']), 'pt-br')
  assert.equal(chooseLanguage(['fr', 'it'], ['en', 'de']), 'en')
  assert.equal(chooseLanguage([], ['en', 'de']), 'en')
})

/* ---- the source ---- */

// prefixes of keys that end in a name, such as that of a server flag, a command or a layer
const COMPOSED = /^(flag|layer|answer|owner|needle|tissue|said)\./
const html = await readFile(path.join(page, 'index.html'), 'utf8')

await check('each key that the source names exists, and each text is used', async () => {
  const used = new Set([...html.matchAll(/ data-t(?:-title|-label)?="([^"]*)"/g)].map(([, key]) => key))
  const all = (await Promise.all(scripts.map(read))).join('\n')
  for (const [, list] of all.matchAll(/\bt\(([^{}]*?)(?:, \{|\))/g)) for (const [, key] of list.matchAll(/'([\w.]+)'/g)) if (key in files.en || !/^(light|ready)$/.test(key)) used.add(key)
  for (const key of used) assert(key in files.en, `no text ${key}`)
  const literal = (key) => all.includes(`'${key}'`) || all.includes(`\`${key}\``)
  const unused = Object.keys(files.en).filter((key) => key !== 'language' && !used.has(key) && !literal(key) && !COMPOSED.test(key))
  assert.deepEqual(unused, [])
})

// units, names of programs and formats, and letters that are the same in every language
const SAME = /^(s|mm|trocar|JSON|CSV|[A-Z]|[–?,.+\-↑↓←→0-9\s]*|0 – 1 mm|20 mm|0\.00 s)$/

await check('index.html has no texts', () => {
  const body = html.slice(html.indexOf('<body'))
  const texts = body.split(/<[^>]*>/).map((text) => text.trim()).filter((text) => !SAME.test(text))
  assert.deepEqual(texts, [])
  // C3.5 is the name of a hole
  const attributes = [...body.matchAll(/ (title|aria-label|alt|placeholder)="([^"]*)"/g)].map(([, , value]) => value).filter((value) => value !== 'C3.5')
  assert.deepEqual(attributes, [])
})

const IDS = ['shape at rest', 'slice frame', 'Gy', 'Pa'] // names of layers, which are shown by the texts layer.*, and units
const { parseAst } = createRequire(path.join(page, 'package.json'))('rollup/parseAst')

/** Returns the strings of a script that look like a text: several words, or a capitalized word. Single words in lower case cannot be distinguished from
 * identifiers. */
function textsOf(code) {
  const texts = []
  const look = (value) => {
    const text = value.replace(/<[^>]*>?|[^<>]*>/g, ' ').trim()
    const names = /^(Key[A-Z]?|Digit\d|Arrow\w*|Space|Comma|Period|Home|Enter)$|px |gradient|rgb\(|max-width|max-height|hover|prefers|pointer:|\[data-|input|select,|^[a-z]+ [a-z]+$/
    if (/[A-Za-zäöü]{2,} [A-Za-zäöü]{2,}|^[A-Z][a-zäöü]+/.test(text) && !names.test(text) && !IDS.includes(text) && !/\b(void|float|uniform|varying|vec3)\b|#/.test(text)) texts.push(text)
  }
  const visit = (node, parent) => {
    if (!node || typeof node.type !== 'string') return
    if (['ImportDeclaration', 'ExportAllDeclaration'].includes(node.type)) return
    if (node.type === 'NewExpression' && node.callee.name === 'Error' || node.type === 'CallExpression' && node.callee.object?.name === 'console') return
    if (node.type === 'CallExpression' && ['t', 'hasText'].includes(node.callee.name)) {
      for (const argument of node.arguments) if (argument.type !== 'Literal') visit(argument, node)
      return
    }
    if (node.type === 'Literal' && typeof node.value === 'string' && parent?.type !== 'ImportExpression') look(node.value)
    if (node.type === 'TemplateElement') look(node.value.cooked)
    for (const [name, value] of Object.entries(node)) if (name !== 'key' || node.computed) (Array.isArray(value) ? value : [value]).forEach((child) => { if (child && typeof child === 'object') visit(child, node) })
  }
  visit(parseAst(code), null)
  return texts
}

await check('the scripts have no texts', async () => {
  assert.deepEqual(textsOf('set(a, "The needle rests."); b.textContent = `Drop ${n} seeds`; c.title = "Pause"; d = t("no.text", { e: "But this one" })'), ['The needle rests.', 'Drop', 'Pause', 'But this one'])
  for (const file of scripts) assert.deepEqual(textsOf(await read(file)), [], file)
})
console.log('passed')
