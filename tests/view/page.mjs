// Shared by live_test.mjs and log_test.mjs: a browser, its pages, and the check of a page's layout.
import assert from 'node:assert/strict'
import path from 'node:path'
import { ADDRESS, axe, launch } from './parts.mjs'

const PATIENCE = 150000 // ms, enough for a busy machine; the tests in this folder do not measure time

export const PICTURES = process.env.TROCAR_PICTURES // folder for screenshots; empty for none
export const browser = await launch()
export const faults = []

/** Opens a page in a window of its own, with further options for its context, and calls `prepare` with the page before loading it. An error in the page fails
   the run. */
export async function open(size = { width: 1000, height: 640 }, options = {}, prepare = () => {}) {
  const page = await (await browser.newContext({ viewport: size, colorScheme: 'dark', ...options })).newPage()
  page.setDefaultTimeout(PATIENCE)
  page.on('pageerror', (error) => faults.push(error.stack))
  page.on('console', (message) => { if (message.type() === 'error' && !/WebSocket connection/.test(message.text())) faults.push(message.text()) })
  await prepare(page)
  await page.goto(ADDRESS)
  await until(page, 'true')
  return page
}

let driver = null // the page that is expected to keep the needle

const lost = (page) => page.evaluate('trocar.drive.lost')

/** Waits until the expression is true in the page. (Playwright's own wait uses eval in the page, which the page's security policy forbids.) */
export async function until(page, expression) {
  for (const end = Date.now() + PATIENCE; Date.now() < end;) {
    if (await page.evaluate(`'trocar' in window && (${expression})`)) return // the page's scripts may still be loading
    if (driver && await lost(driver)) assert.fail(`the needle was let go before ${expression}`)
    await new Promise((done) => setTimeout(done, 50))
  }
  assert.fail(`never: ${expression}; faults ${faults}; next step ${await page.evaluate("document.getElementById('next').textContent")}; status ${await page.evaluate('JSON.stringify({ ...trocar.status, values: undefined })')}`)
}

/** Holds a key down until the expression is true. Presses it up to `times` times, because on a busy machine the needle or the probe may stop. */
export async function pressUntil(page, key, done, times = 20) {
  for (let i = 0; i < times && !await page.evaluate(done); i++) {
    await page.keyboard.down(key)
    for (const end = Date.now() + 3000; Date.now() < end && !await page.evaluate(done);) await page.waitForTimeout(30)
    await page.keyboard.up(key)
  }
  await until(page, done)
}

/** Returns the position of a hole's centre on the screen. */
export const holeOnScreen = (page, hole) => page.evaluate((name) => {
  const { procedure, echo } = trocar, { template } = procedure, place = template.place(template.find(name)), box = echo.canvas.getBoundingClientRect()
  const [x, y] = echo.toPixel(place.x, place.y), ratio = echo.marks.width / box.width
  return [box.left + x / ratio, box.top + y / ratio]
}, hole)

export async function check(name, body) {
  const start = Date.now()
  await body()
  console.log(`ok ${name} (${((Date.now() - start) / 1000).toFixed(1)} s)`)
}

/** Takes the needle by calling `take`, which by default clicks the button. */
export async function hold(page, take = () => page.click('#take')) {
  if (!await page.evaluate('trocar.status.drives')) await take(page)
  await until(page, 'trocar.status.drives && trocar.status.owned === "here"')
}

/** Runs a check while the page holds the needle. If the server or the page is silent for too long, as may happen on a busy machine, the needle is released
   and the check is repeated. `take`: as in hold(). */
export async function driven(name, page, body, take) {
  await check(name, async () => {
    for (let attempt = 1; ; attempt++) {
      await hold(page, take)
      driver = page
      try {
        return await body()
      } catch (error) {
        if (!await lost(page) || attempt === 4) throw error
        console.log(`   once more: ${name}: ${await lost(page)} ${error.message}`)
        for (const key of ['w', 'a']) await page.keyboard.up(key)
        await page.mouse.up()
      } finally {
        driver = null
      }
    }
  })
}

/** Saves a screenshot of the page for people to look at, if test_view.sh was given a folder for them. */
export async function shoot(page, name) {
  if (PICTURES) await page.screenshot({ path: path.join(PICTURES, `${name}.png`) })
}

/** Checks that no element overlaps another or is cut off, and that axe-core finds no violations. */
export async function checkLayout(page, name) {
  await checkAccess(page, name)
  await checkPlaces(page, name)
}

/** Checks in both themes that axe-core finds no violations. */
export async function checkAccess(page, name) {
  if (!await page.evaluate('"axe" in window')) await page.evaluate(axe)
  await page.evaluate(stopDrawing)
  try {
    for (const theme of ['light', 'dark']) { // the pages are dark before and after this check
      await page.evaluate((theme) => trocar.setTheme(theme), theme)
      await page.evaluate(plainGround, theme)
      const { violations, contrast } = await page.evaluate(objections)
      assert.deepEqual(violations, [], `${name}, ${theme}`)
      assert(contrast, 'axe-core has looked at contrasts')
      await page.evaluate(plainGround, null)
    }
  } finally {
    await page.evaluate(drawAgain)
  }
}

/** Checks that axe-core finds no violations in a saved report. */
export async function checkReport(page, name) {
  await page.evaluate(axe)
  const { violations, contrast } = await page.evaluate(objections)
  assert.deepEqual(violations, [], name)
  assert(contrast, 'axe-core has looked at contrasts')
}

/** Checks that no element overlaps another or is cut off. */
export async function checkPlaces(page, name) {
  assert.deepEqual(await page.evaluate(layoutFaults), [], name)
  assert.deepEqual(await page.evaluate(textFaults), [], name)
}

/** Checks that those of these elements that are shown are fully visible without scrolling. */
export async function checkInView(page, selectors, name) {
  assert.deepEqual(await page.evaluate(hiddenParts, selectors), [], name)
}

/** Run in the page. Stop and resume drawing, because drawing in software would take up most of the time while axe-core checks the page. */
function stopDrawing() {
  window.later = { draw: window.requestAnimationFrame, frames: [] }
  window.requestAnimationFrame = (frame) => later.frames.push(frame)
}
function drawAgain() {
  window.requestAnimationFrame = later.draw
  later.frames.forEach((frame) => requestAnimationFrame(frame))
}

/** Runs in the page. Returns axe-core's violations, and whether it checked contrast. (Transferring all results takes longer than the check.) The size of
   click targets is only checked on touch screens. */
async function objections() {
  const { violations, passes } = await axe.run({ resultTypes: ['violations'], rules: { 'target-size': { enabled: matchMedia('(pointer: coarse)').matches } } })
  return { violations: violations.map(({ id, nodes }) => `${id}: ${nodes.map(({ target, any }) => `${target} ${any.map(({ message }) => message)}`)}`),
           contrast: passes.some(({ id }) => id === 'color-contrast') }
}

/** Runs in the page. Gives the text on the 3D view a plain background, because axe-core cannot assess contrast on gradients and canvases. Uses the end of the
   gradient that has the lower contrast. */
function plainGround(theme) {
  const stage = document.getElementById('stage'), hidden = theme ? 'hidden' : ''
  stage.style.background = { dark: '#1d2732', light: '#e0e7ee' }[theme] ?? ''
  for (const canvas of document.querySelectorAll('#stage canvas, #trus canvas, #sagittal canvas')) canvas.style.visibility = hidden
}

/** Runs in the page. Returns texts that extend beyond their background, or beyond the element that clips them. Texts shortened by an ellipsis must have a
   title with the full text. */
function textFaults() {
  const faults = [], dialog = document.querySelector('dialog[open]'), walker = document.createTreeWalker(dialog ?? document.body, NodeFilter.SHOW_TEXT)
  while (walker.nextNode()) {
    const text = walker.currentNode, parent = text.parentElement
    if (!text.data.trim() || !dialog && text.parentElement.closest('dialog') || parent.closest('select, script, style, [hidden]') || !parent.checkVisibility({ visibilityProperty: true })) continue
    const range = document.createRange()
    range.selectNodeContents(text)
    for (const { left, right } of range.getClientRects()) {
      for (let ground = parent; ground && ground !== document.documentElement; ground = ground.parentElement) {
        const style = getComputedStyle(ground), box = ground.getBoundingClientRect(), clips = style.overflowX !== 'visible'
        if (clips && style.textOverflow === 'ellipsis') break
        if (style.display === 'inline' || !(clips || ground.matches('.panel, section, header, footer, dialog, button, td, th, .badge'))) continue
        if (right > left && (left < box.left - 1 || right > box.right + 1)) faults.push(`“${text.data.trim().slice(0, 30)}” sticks out of ${ground.id || ground.tagName} by ${Math.max(box.left - left, right - box.right).toFixed(0)} px`)
      }
    }
  }
  return faults
}

/** Runs in the page: see checkInView. */
function hiddenParts(selectors) {
  return [...document.querySelectorAll(selectors)].filter((part) => part.checkVisibility({ visibilityProperty: true })).flatMap((part) => {
    const box = part.getBoundingClientRect(), faults = []
    for (let around = part.parentElement; around && around !== document.documentElement; around = around.parentElement) {
      if (getComputedStyle(around).overflowY === 'visible') continue
      const clip = around.getBoundingClientRect(), seen = Math.min(box.bottom, clip.bottom) - Math.max(box.top, clip.top)
      if (seen < box.height - 1) faults.push(`${part.id || part.tagName}: ${Math.max(0, seen).toFixed(0)} of ${box.height.toFixed(0)} px in view`)
    }
    return faults
  })
}

/** Runs in the page. Returns elements that overlap, are cut off, or are outside the window. */
function layoutFaults() {
  const dialog = document.querySelector('dialog[open]'), SCROLLERS = 'dialog, #plots, #needle-list, #dose-pane, #implant'
  const parts = [...(dialog ? [dialog] : []), ...(dialog ?? document).querySelectorAll('h1, h2, button, label, summary, dt, dd, th, td, select, output, input[type=range], input[type=text], #next, #answer:not(:empty), #panes, canvas#timeline, .badge, .panel, #readout, #legend span, #banner, #drive-note:not(:empty), .stick-area, #scene-name, .u-series, #plots .uplot')]
    .filter((part) => (dialog || !part.closest('dialog')) && part.checkVisibility({ visibilityProperty: true }) && part.getBoundingClientRect().width > 0)
  const name = (part) => part.id || `${part.tagName.toLowerCase()} "${part.textContent.trim().slice(0, 20)}"`
  const boxOf = (part) => { // the visible part
    let { left, right, top, bottom } = part.getBoundingClientRect()
    for (let scroller = part.parentElement?.closest(SCROLLERS); scroller; scroller = scroller.parentElement?.closest(SCROLLERS)) {
      const box = scroller.getBoundingClientRect()
      top = Math.max(top, box.top)
      bottom = Math.min(bottom, box.bottom)
    }
    return { left, right, top, bottom }
  }
  const faults = [], boxes = parts.map(boxOf)
  parts.forEach((part, i) => {
    const a = boxes[i]
    if (a.bottom <= a.top) return
    if (a.left < -1 || a.top < -1 || a.right > innerWidth + 1 || a.bottom > innerHeight + 1) faults.push(`${name(part)} is outside the window`)
    if (!part.title && part.scrollWidth > part.clientWidth + 1 && part.clientWidth > 0 && getComputedStyle(part).display !== 'inline') faults.push(`${name(part)} is cut off`)
    for (let k = i + 1; k < parts.length; k++) {
      const b = boxes[k], across = Math.min(a.right, b.right) - Math.max(a.left, b.left), down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top)
      if (across > 1 && down > 1 && !part.contains(parts[k]) && !parts[k].contains(part)) faults.push(`${name(part)} and ${name(parts[k])}`)
    }
  })
  const names = [...document.querySelectorAll('#plots > div')].map((plot) => [...plot.querySelectorAll('th')].map((th) => th.textContent))
  for (const series of names) if (new Set(series).size < series.length) faults.push(`two series of one name: ${series}`)
  return faults
}
