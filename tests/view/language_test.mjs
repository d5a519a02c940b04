/* Tests the page's languages, using it by touch, and telling two pages of one trocar-view apart. Run by test_view.sh in a private network.
   usage: language_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { readFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkLayout, faults, hold, holeOnScreen, open, shoot as shootPage, until } from './page.mjs'
import { source, start, stop } from './parts.mjs'

const SIZES = [[390, 844], [1024, 768]]
const pelvis = path.join(source, 'meshes/pelvis.yaml')
const read = async (code) => JSON.parse(await readFile(path.join(source, `clients/view/page/src/words/${code}.json`), 'utf8'))
const german = await read('de'), english = await read('en')
const text = (id) => `document.getElementById('${id}').textContent`
const live = "trocar.state.name === 'live' && document.body.classList.contains('procedure')"
const shoot = (page, name) => shootPage(page, `language-${name}`)

/** All messages in brackets, so that any text without brackets on the page does not come from the message files. */
const marked = Object.fromEntries(Object.entries(english).map(([key, message]) =>
  [key, typeof message === 'string' ? `⟦${message}⟧` : Object.fromEntries(Object.entries(message).map(([form, words]) => [form, `⟦${words}⟧`]))]))

/** Replaces the German texts with `messages`, and records what is drawn on canvases. */
const replaceTexts = (messages) => async (page) => {
  await page.route(/assets\/de-[^/]*\.js$/, (route) => (messages ? route.fulfill({ contentType: 'text/javascript', body: `export default ${JSON.stringify(messages)}` }) : route.abort()))
  await page.addInitScript(() => {
    window.drawn = new Set()
    const draw = CanvasRenderingContext2D.prototype.fillText
    CanvasRenderingContext2D.prototype.fillText = function (words, ...rest) { window.drawn.add(words); return draw.call(this, words, ...rest) }
  })
}

let view = await start('clients/view/trocar-view', '--scene', pelvis), server, page, second
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', pelvis)

  await check('all texts on the page come from the message files', async () => {
    page = await open({ width: 1280, height: 800 }, { locale: 'de-DE' }, replaceTexts(marked))
    await until(page, `${live} && /Dose/.test(${text('dose')}) && trocar.tissue.available`)
    await page.evaluate("trocar.procedure.choose(trocar.procedure.template.find('G4'))")
    await page.click('#tissue-button')
    await page.evaluate("document.getElementById('tissue').close()")
    await until(page, `/G4/.test(${text('target')}) && drawn.size > 10`)
    assert.deepEqual(await page.evaluate(textsBeside), [])
    await page.click('#mode') // switches to the page with plots
    await until(page, '!document.body.classList.contains("procedure")')
    await page.click('#take')
    await until(page, 'trocar.status.drives')
    await page.click('#take')
    await until(page, '!trocar.status.drives')
    await page.waitForTimeout(500)
    assert.deepEqual(await page.evaluate(textsBeside), [])
    await page.context().close()
  })

  await check('a language that cannot be loaded, and texts that it lacks, are English', async () => {
    page = await open({ width: 600, height: 400 }, { locale: 'de-DE' }, replaceTexts({ help: 'Hilfe' }))
    await until(page, live)
    assert.deepEqual(await page.evaluate(`[${text('help')}, ${text('screenshot')}]`), ['Hilfe', english.screenshot])
    await page.context().close()
    page = await open({ width: 600, height: 400 }, { locale: 'de-DE' }, replaceTexts(null))
    await until(page, live)
    assert.deepEqual(await page.evaluate(`[document.documentElement.lang, ${text('screenshot')}]`), ['en', english.screenshot])
    await page.context().close()
    faults.splice(0, faults.length, ...faults.filter((fault) => !/ERR_FAILED/.test(fault))) // removes the fault of the request that was aborted on purpose
  })

  await check('the menu changes the language, which the browser keeps', async () => {
    page = await open({ width: 1280, height: 800 })
    await until(page, live)
    assert.equal(await page.evaluate('document.documentElement.lang'), 'en')
    await page.click('#help')
    await until(page, "document.getElementById('language').options.length > 1")
    assert.deepEqual(await page.evaluate("[...document.getElementById('language').options].map(({ text }) => text)"), ['English', 'Deutsch'])
    await checkLayout(page, 'help')
    await shoot(page, 'help-en')
    await Promise.all([page.waitForNavigation(), page.selectOption('#language', 'de')])
    await until(page, live)
    assert.equal(await page.evaluate(`document.documentElement.lang + ${text('screenshot')}`), `de${german.screenshot}`)
    await page.goto(page.url().split('?')[0])
    await until(page, `${live} && document.documentElement.lang === 'de'`)
  })

  for (const [width, height] of SIZES)
    await check(`layout in German, ${width} x ${height}`, async () => {
      await page.setViewportSize({ width, height })
      for (const mode of ['implant', 'plots']) {
        await page.waitForTimeout(300)
        await checkLayout(page, `${width} x ${height}, ${mode}`)
        await shoot(page, `de-${mode}-${width}`)
        await page.evaluate("document.getElementById('mode').click()")
      }
      for (const dialog of ['keys', 'tissue']) {
        await page.evaluate(`document.getElementById('${dialog}').showModal()`)
        await checkLayout(page, `${width} x ${height}, ${dialog}`)
        await shoot(page, `de-${dialog}-${width}`)
        await page.evaluate(`document.getElementById('${dialog}').close()`)
      }
    })

  await check('two pages are told apart', async () => {
    await page.setViewportSize({ width: 900, height: 600 })
    assert.equal(await page.evaluate('document.getElementById("page-number").hidden'), true) // a single page needs no number
    second = await open({ width: 900, height: 600 })
    await until(second, `${live} && trocar.status.pages === 2`)
    await until(page, 'trocar.status.pages === 2')
    await until(page, `${text('page-number')} === 'Seite 1'`)
    await until(second, `${text('page-number')} === 'page 2'`)
    assert.deepEqual([await page.title(), await second.title()], ['Seite 1, pelvis.yaml – trocar', 'Page 2, pelvis.yaml – trocar'])
    await page.click('#take')
    await until(second, `${text('drive-note')} === 'Page 1 drives it.'`)
    await until(page, "document.getElementById('page-number').classList.contains('driving')")
    await shoot(second, 'second-page')
    await page.click('#take')
    await second.context().close()
    await until(page, "document.getElementById('page-number').hidden")
    assert.equal(await page.title(), 'pelvis.yaml – trocar')
    await page.context().close()
  })

  for (const [width, height] of [[390, 844], [768, 1024]])
    await check(`by touch alone: hole, needle, push and seed; targets are large enough, ${width} x ${height}`, async () => {
      page = await open({ width, height }, { hasTouch: true, isMobile: true, locale: 'de-DE' })
      await until(page, live)
      await page.waitForTimeout(300)
      await page.touchscreen.tap(...await holeOnScreen(page, 'G4'))
      await until(page, 'trocar.procedure.hole !== null')
      await page.tap('#take')
      await until(page, 'trocar.status.drives && trocar.stage.needles[trocar.chosen].tip')
      await until(page, 'Math.abs(trocar.stage.needles[trocar.chosen].tip.x - trocar.procedure.template.place(trocar.procedure.hole).x) < 1e-3')
      await checkLayout(page, 'touch')
      await shoot(page, `touch-${width}`)
      await touchLever(page, 0.05, 'trocar.history.columns[7][trocar.history.count - 1] > 0.02')
      await page.tap('#drop')
      await until(page, 'trocar.procedure.seeds.pending[trocar.chosen] === 1')
      await page.tap('#undo')
      await until(page, 'trocar.procedure.seeds.pending[trocar.chosen] === 0')
      await touchLever(page, 0.95, 'trocar.stage.needles[trocar.chosen].tip.z < -0.02')
      await page.tap('#take')
      await until(page, '!trocar.status.drives')
      await page.context().close()
    })
  assert.deepEqual(faults, [])
} finally {
  await stop(server)
  await stop(view)
  await browser.close()
}
console.log('passed')

/** Holds the lever with a finger until the expression is true. `part`: the finger's distance from the top, as a fraction of the lever's height. Takes the
   needle again if it has been released, as may happen on a busy machine. */
async function touchLever(page, part, done) {
  const touch = await page.context().newCDPSession(page)
  for (let times = 0; times < 40 && !await page.evaluate(done); times++) {
    await hold(page, () => page.tap('#take'))
    const { x, y, width, height } = await page.locator('#lever').boundingBox(), point = { x: x + width / 2, y: y + part * height }
    await touch.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [point] })
    for (const end = Date.now() + 3000; Date.now() < end && !await page.evaluate(done);) await page.waitForTimeout(50)
    await touch.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] })
  }
  await until(page, done)
}

/** Runs in the page. Returns texts, titles, labels and texts drawn on canvases with words outside brackets, other than names from the scene, units and keys. */
function textsBeside() {
  const { scene } = trocar.stage, found = new Set(), NAMES = ['English', 'Deutsch', 'trocar', scene.path, scene.path.split('/').pop(), ...scene.regions.flatMap(({ name, organ }) => [name, organ]), ...scene.membranes.map(({ name }) => name)]
  const UNITS = /^(s|mm|mm\/s|mN m|N|N\/m|Pa|s\/m²?|µs|ms|kHz|dB|Gy|U|cm³|min|auto|x|y|z|[A-Z]{1,2}|[A-Z]\d(\.5)?|[a-z_]+\[[^\]]*\]|JSON|CSV)$/
  const look = (words, where) => {
    let rest = String(words ?? '')
    while (/⟦[^⟦⟧]*⟧/.test(rest)) rest = rest.replace(/⟦[^⟦⟧]*⟧/g, ' ')
    for (const name of NAMES.filter(Boolean).sort((a, b) => b.length - a.length)) rest = rest.replaceAll(name, ' ')
    const left = rest.split(/[\s,;:·()–%°+]+/).filter((word) => /\p{L}/u.test(word) && !UNITS.test(word))
    if (left.length && !UNITS.test(rest.trim())) found.add(`${where}: ${words}`)
  }
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_ALL)
  while (walker.nextNode()) {
    const node = walker.currentNode, holder = node.parentElement?.closest('[id]')?.id ?? ''
    if (node.nodeType === Node.TEXT_NODE && !node.parentElement.closest('script, style')) look(node.data, holder)
    if (node.nodeType === Node.ELEMENT_NODE) for (const name of ['title', 'aria-label', 'placeholder', 'aria-valuetext']) if (node.hasAttribute(name) && node.id !== 'scene-name') look(node.getAttribute(name), `${holder} ${name}`)
  }
  for (const words of window.drawn) look(words, 'drawn')
  return [...found]
}
