/* Plays a new user's session, from `scripts/demo --implant --view` to the report of its task: with the mouse alone, with the keyboard alone, or by touch alone on
   a tablet. Saves a picture of each step, and counts minutes (from loading the page), clicks, keys and touches. Fails if any other kind of input is used. The demo
   must have been built, and port 8686 be free. Run by hand:
   node tests/view/session.mjs BUILD_DIR SOURCE_DIR OUT_DIR mouse|keyboard|touch */
import assert from 'node:assert/strict'
import { spawn } from 'node:child_process'
import { mkdir, writeFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, faults, holeOnScreen, open, until } from './page.mjs'
import { source } from './parts.mjs'

const [OUT, way] = process.argv.slice(4), HOLE = 'E3.5'
const SIZES = { mouse: { width: 1280, height: 800 }, keyboard: { width: 1280, height: 800 }, touch: { width: 1024, height: 768 } }
const count = { clicks: 0, keys: 0, touches: 0, holds: 0 }
const along = "trocar.procedure.tipError(trocar.stage.needles[trocar.chosen].tip)?.along", left = 'trocar.procedure.seeds.seeds.length', pending = 'trocar.procedure.seeds.pending[trocar.chosen] > 0'
const OUTSIDE = 'trocar.procedure.template.depthOf(trocar.stage.needles[trocar.chosen].tip) < 0'
let page, finger, shots = 0
const shoot = (name) => page.screenshot({ path: path.join(OUT, `${way}-${++shots}-${name}.png`) })

const onLever = async (part) => { const { x, y, width, height } = await page.locator('#lever').boundingBox({ timeout: 2000 }); return { x: x + width / 2, y: y + part * height } }
const focus = () => page.evaluate('document.activeElement.id')

async function press(key) { count.keys++; await page.keyboard.press(key) }
async function tabTo(id) { for (let i = 0; i < 60 && await focus() !== id; i++) await press('Tab'); assert.equal(await focus(), id) }

/** For each kind of input: starts and stops holding the control that moves the needle inward (`sign` 1) or outward (-1), slowly or fast. */
const HOLD = {
  mouse: { begin: async (sign, slow) => { const { x, y } = await onLever(0.5 - sign * (slow ? 0.15 : 0.48)); await page.mouse.move(x, y); await page.mouse.down(); count.clicks++ }, end: () => page.mouse.up() },
  keyboard: {
    begin: async (sign, slow) => { count.keys += slow ? 2 : 1; if (slow) await page.keyboard.down('Shift'); await page.keyboard.down(sign > 0 ? 'w' : 's') },
    end: async () => { for (const key of ['w', 's', 'Shift']) await page.keyboard.up(key) },
  },
  touch: {
    begin: async (sign, slow) => { count.touches++; await finger.send('Input.dispatchTouchEvent', { type: 'touchStart', touchPoints: [await onLever(0.5 - sign * (slow ? 0.15 : 0.48))] }) },
    end: () => finger.send('Input.dispatchTouchEvent', { type: 'touchEnd', touchPoints: [] }),
  },
}[way]

/** Takes the needle again if it has been released, as may happen on a busy machine. */
async function hold() {
  for (let times = 0; times < 20 && !await page.evaluate('trocar.drive.steering'); times++) {
    if (!await page.evaluate('trocar.drive.driving || document.getElementById("take").disabled')) await DO.take()
    await page.waitForTimeout(1000)
  }
  await until(page, 'trocar.drive.steering')
}

/** Moves the needle until the expression is true. */
async function move(sign, slow, done) {
  for (let times = 0; times < 60 && !await page.evaluate(done); times++) {
    await hold()
    count.holds++
    try { await HOLD.begin(sign, slow) } catch { continue } // the needle has been released in the meantime
    for (const end = Date.now() + 8000; Date.now() < end && !await page.evaluate(done) && await page.evaluate('trocar.drive.steering');) await page.waitForTimeout(15)
    await HOLD.end()
  }
  await until(page, done)
}

/** Drops a seed. Tries again if the page has released the needle in the meantime. */
async function drop() {
  for (let times = 0; times < 10 && !await page.evaluate(pending); times++) {
    await hold()
    await DO.drop()
    for (const end = Date.now() + 5000; Date.now() < end && !await page.evaluate(pending) && await page.evaluate('trocar.drive.steering');) await page.waitForTimeout(50)
  }
  await until(page, pending)
}

/** Moves the tip to the target ring, and corrects it after the tissue has followed. */
async function reach() {
  for (let times = 0; times < 12; times++) {
    const off = await page.evaluate(along)
    if (Math.abs(off) < 1e-3) return
    await move(Math.sign(off), Math.abs(off) < 0.01, `${Math.sign(off)} * ${along} < ${Math.abs(off) < 0.01 ? 3e-4 : 4e-3}`)
    await page.waitForTimeout(700)
  }
}

const click = (id) => async () => { count.clicks++; await page.click(`#${id}`) }, tap = (id) => async () => { count.touches++; await page.tap(`#${id}`) }
const key = (name) => async () => { await page.evaluate('document.activeElement.blur()'); await press(name) }
const DO = {
  mouse: { start: click('task-start'), take: click('take'), drop: click('drop'), open: click('task-button'), finish: click('task-finish'), hole: async () => { count.clicks++; await page.mouse.click(...await holeOnScreen(page, HOLE)) } },
  touch: { start: tap('task-start'), take: tap('take'), drop: tap('drop'), open: tap('task-button'), finish: tap('task-finish'), hole: async () => { count.touches++; await page.touchscreen.tap(...await holeOnScreen(page, HOLE)) } },
  keyboard: { start: () => press('Enter'), take: key('t'), drop: key('x'), open: async () => { await tabTo('task-button'); await press('Enter') }, finish: async () => { await tabTo('task-finish'); await press('Enter') },
              hole: async () => { await key('h')(); for (const letter of HOLE) await press(letter); await press('Enter') } },
}[way]

await mkdir(OUT, { recursive: true })
const demo = spawn(path.join(source, 'scripts/demo'), ['--implant', '--view'], { stdio: ['ignore', 'pipe', 'inherit'], detached: true })
await new Promise((done, fail) => {
  demo.stdout.on('data', (piece) => { if (/^Open http/m.test(`${piece}`)) done() })
  demo.on('exit', () => fail(new Error('scripts/demo ended')))
})
demo.removeAllListeners('exit')
try {
  const began = Date.now()
  page = await open(SIZES[way], way === 'touch' ? { hasTouch: true, isMobile: true } : {})
  finger = await page.context().newCDPSession(page)
  const forbidden = { mouse: ['touchstart', 'keydown'], keyboard: ['pointerdown', 'touchstart'], touch: ['keydown'] }[way]
  await page.evaluate((kinds) => { for (const kind of kinds) addEventListener(kind, () => { throw new Error(`${kind} in a session without it`) }, true) }, forbidden)
  await until(page, "trocar.state.name === 'live' && document.getElementById('task').open")
  await page.waitForTimeout(500)
  await shoot('task')
  await DO.start()
  await until(page, "!document.getElementById('task').open && trocar.echo.simulated")
  await shoot('started')
  await DO.hole()
  await until(page, `trocar.procedure.hole && trocar.procedure.template.name(trocar.procedure.hole) === '${HOLE}'`)
  await DO.take()
  await until(page, 'trocar.status.drives && trocar.procedure.template.aside(trocar.stage.needles[trocar.chosen].tip, trocar.procedure.hole).length() < 5e-4')
  await shoot('at-hole')
  await move(1, false, `${along} < -0.006`) // first past the ring, because tissue sticks to the shaft, and then back to it
  await reach()
  await shoot('at-target')
  for (let seed = 1; seed <= 4; seed++) {
    if (seed > 1) await reach()
    await drop()
    await move(-1, seed < 4, `${left} === ${seed}`)
    await page.waitForTimeout(500)
  }
  await shoot('seeds')
  await move(-1, false, OUTSIDE)
  await DO.open()
  await until(page, "document.getElementById('task').open")
  await DO.finish()
  await until(page, "document.getElementById('task-report').shadowRoot.querySelector('.verdict') !== null")
  const minutes = (Date.now() - began) / 60000
  await page.waitForTimeout(300)
  await shoot('report')
  const verdict = await page.evaluate("document.getElementById('task-report').shadowRoot.querySelector('.verdict').textContent")
  await page.evaluate("document.getElementById('task').scrollTo(0, 1e5)")
  await shoot('report-end')
  assert.deepEqual(faults, [])
  const result = { way, minutes: Number(minutes.toFixed(1)), ...count, verdict }
  await writeFile(path.join(OUT, `${way}.json`), `${JSON.stringify(result)}\n`)
  console.log(result)
} finally {
  await browser.close()
  process.kill(-demo.pid, 'SIGINT') // the whole group, as Ctrl-C does
}
