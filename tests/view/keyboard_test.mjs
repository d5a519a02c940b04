/* Tests that a trainee's task can be done with the keyboard alone, from loading the page to the report. Also tests the page's sounds. axe-core checks each
   dialog on the way. Run by test_view.sh in a private network.
   usage: keyboard_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { writeFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkLayout, driven, faults, open, shoot, until } from './page.mjs'
import { ready, run, source, start, stop } from './parts.mjs'

const OUT = process.argv[4], implant = path.join(source, 'meshes/implant.yaml'), task = path.join(OUT, 'reach.yaml')
const text = (id) => `document.getElementById('${id}').textContent`
const says = (id, pattern) => until(page, `${pattern}.test(${text(id)})`)
await writeFile(task, `title: Reach it
text: Bring the tip to the target and leave a seed there.
scene: ${implant}
targets: [{name: target, position: [0.010, -0.005, 0.045], hole: E3.5}]
organs: {gland: [prostate]}
criteria:
  - {measure: passes, most: 1, source: a choice}
hints: [Do not hurry.]
`)

/** Returns the id or, without one, the label of the element that has the focus. */
const focus = () => page.evaluate("(({ id, ariaLabel, textContent }) => id || ariaLabel || textContent.trim())(document.activeElement)")

/** Presses Tab until this element has the focus. */
async function tabTo(id) {
  for (let times = 0; times < 60 && await focus() !== id; times++) await page.keyboard.press('Tab')
  assert.equal(await focus(), id)
}

/** Holds a key down until the expression is true. (On a busy machine, the needle may be stopped in the meantime.) */
async function press(key, done) {
  for (let times = 0; times < 40 && !await page.evaluate(done); times++) {
    await page.keyboard.down(key)
    for (const end = Date.now() + 1500; Date.now() < end && !await page.evaluate(done);) await page.waitForTimeout(30)
    await page.keyboard.up(key)
  }
  await until(page, done)
}

let view = await ready(run('clients/view/trocar-view', '--task', task, '--runs', path.join(OUT, 'runs'))), server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', implant)
  page = await open({ width: 900, height: 600 }) // small, so that it is drawn quickly: the needle moves slowly while the page shows outdated frames.
  // Clicks, touches and pointer movements make the test fail.
  await page.evaluate(() => { for (const kind of ['pointerdown', 'pointermove', 'touchstart']) addEventListener(kind, () => { throw new Error(`${kind} in a test by keyboard`) }, true) })

  await check('Enter starts the task, whose dialog has the focus', async () => {
    await until(page, `trocar.state.name === 'live' && document.getElementById('task').open`)
    assert.equal(await focus(), 'task-start')
    await checkLayout(page, 'task')
    await page.keyboard.press('Enter')
    await until(page, "!document.getElementById('task').open")
  })

  await check('Tab reaches each control once, in the order of the page, and shows where it is', async () => {
    await page.evaluate('document.activeElement.blur()')
    const seen = []
    for (let times = 0; times < 80; times++) {
      await page.keyboard.press('Tab')
      const here = await page.evaluate(() => {
        const at = document.activeElement, controls = [...document.querySelectorAll('button, input, select, summary, canvas[tabindex], section[tabindex], div[tabindex]')]
        return at === document.body ? null : { index: controls.indexOf(at), name: at.id || at.textContent, drawn: at.checkVisibility({ visibilityProperty: true }) && getComputedStyle(at).outlineStyle !== 'none' }
      })
      if (!here && seen.length === 0) continue // the dialog just closed was last in the page, so the first Tab wraps to the top; ignore that
      if (!here || seen.some(({ index }) => index === here.index)) break
      seen.push(here)
    }
    for (const { name, drawn } of seen) assert(drawn, `${name} has the focus, and does not show it`)
    const places = seen.map(({ index }) => index)
    assert.deepEqual(places, [...places].sort((a, b) => a - b), seen.map(({ name }) => name).join())
    for (const id of ['task-button', 'tissue-button', 'help', 'take', 'hole', 'timeline', 'window', 'play']) assert(seen.some(({ name }) => name === id), `${id} of ${seen.map(({ name }) => name)}`)
  })

  await check('the help opens by ?, and closes by Escape', async () => {
    await page.keyboard.press('?')
    await until(page, "document.getElementById('keys').open")
    await page.keyboard.press('Escape')
    await until(page, "!document.getElementById('keys').open")
  })

  await check('keys turn and zoom the view', async () => {
    const eye = () => page.evaluate('(({ camera, controls }) => { const at = camera.position.clone().sub(controls.target); return { distance: at.length(), along: Math.atan2(at.dot({ x: 1, y: 0, z: 0 }), at.dot({ x: 0, y: 0, z: 1 })), up: Math.asin(at.dot(camera.up) / at.length()) } })(trocar.stage)')
    const start = await eye()
    for (const [key, back, differs] of [['5', '6', (a) => Math.abs(a.along - start.along)], ['7', '8', (a) => a.up - start.up], ['9', '0', (a) => 10 * Math.log(start.distance / a.distance)]]) {
      await page.keyboard.press(key)
      const turned = differs(await eye())
      assert(turned > 0.02, `${key}: ${turned}`)
      await page.keyboard.press(back)
      assert(Math.abs(differs(await eye())) < 1e-6, back)
    }
  })

  await check('with Shift, these keys move what is in view left, right, up and down', async () => {
    const place = () => page.evaluate('(({ camera, box }) => { camera.updateMatrixWorld(); const { x, y } = box.min.clone().project(camera); return [x, y] })(trocar.stage)'), start = await place()
    for (const [key, back, axis, sign] of [['5', '6', 0, -1], ['7', '8', 1, 1]]) {
      await page.keyboard.press(`Shift+Digit${key}`)
      const moved = (await place())[axis] - start[axis]
      assert(sign * moved > 0.03, `${key}: ${moved}`)
      await page.keyboard.press(`Shift+Digit${back}`)
      assert(Math.abs((await place())[axis] - start[axis]) < 1e-6, back)
    }
  })

  await check('the scanner opens, and its knobs move, by keyboard', async () => {
    await page.evaluate("document.querySelector('#scan summary').focus()")
    await page.keyboard.press('Enter')
    await page.keyboard.press('Tab')
    assert.equal(await focus(), 'scan-gain')
    await page.keyboard.press('ArrowRight')
    assert.equal(await page.evaluate('trocar.echo.look.gain'), 1)
    await page.keyboard.press('ArrowLeft')
    await page.evaluate("document.querySelector('#scan summary').focus()")
    await page.keyboard.press('Enter')
  })

  await check('sounds are off until they are turned on', async () => {
    assert.deepEqual(await page.evaluate('[trocar.sound.box.checked, trocar.sound.context]'), [false, null])
    await page.evaluate("trocar.sound.play('puncture')")
    assert.equal(await page.evaluate('trocar.sound.played.puncture'), 0)
    await page.evaluate('document.activeElement.blur()')
    await page.keyboard.press('o')
    assert.deepEqual(await page.evaluate('[trocar.sound.box.checked, trocar.sound.played.puncture]'), [true, 1])
    await until(page, "trocar.sound.context.state === 'running'")
  })

  await driven('a hole is named, the needle taken, and pushed to the target', page, async () => {
    await page.keyboard.press('h')
    assert.equal(await focus(), 'hole')
    await page.keyboard.type('E3.5')
    await page.keyboard.press('Enter')
    await says('target', /^E3.5, 70.0 mm/)
    await page.keyboard.press('-')
    await says('target', /^E3.5, 69.0 mm/)
    await page.keyboard.press('+')
    await says('target', /^E3.5, 70.0 mm/)
    await press('w', 'trocar.procedure.tipError(trocar.stage.needles[0].tip)?.along < 0.004')
    assert(await page.evaluate('trocar.sound.played.puncture') > 1, 'the puncture is heard')
  }, byKey)

  await driven('a seed is dropped, left and taken back', page, async () => {
    await page.keyboard.press('x')
    await until(page, 'trocar.procedure.seeds.pending[0] === 1')
    await press('s', 'trocar.procedure.seeds.seeds.length === 1')
    await says('answer', /Seed 1 is in the tissue/)
    await until(page, 'trocar.sound.played.seed === 1')
    await press('u', 'trocar.procedure.seeds.seeds.length === 0')
    await says('answer', /The last seed is taken back/)
  }, byKey)

  await check('the needle is left in, chosen in the list, and pulled out by the letter on the key', async () => {
    await page.keyboard.press('e')
    await until(page, "trocar.procedure.states[0].state === 'resting' && !trocar.status.drives")
    // a German keyboard has Z where others have Y
    await page.evaluate("document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'y', code: 'KeyZ', bubbles: true }))")
    await page.waitForTimeout(300)
    assert.equal(await page.evaluate('trocar.procedure.states[0].state'), 'resting')
    await page.evaluate("document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'z', code: 'KeyY', bubbles: true }))")
    await says('answer', /Needle 0 is out/)
  })

  await check('arrows on the time line step through the past, and Home returns', async () => {
    await tabTo('timeline')
    await page.keyboard.press('ArrowLeft')
    await until(page, "trocar.state.name === 'past'")
    await page.keyboard.press('Home')
    await until(page, "trocar.state.name === 'live'")
  })

  await check('the report is reached by Tab and Enter', async () => {
    await tabTo('task-button')
    await page.keyboard.press('Enter')
    await until(page, "document.getElementById('task').open")
    await tabTo('task-finish')
    await page.keyboard.press('Enter')
    await until(page, "document.getElementById('task-report').shadowRoot.querySelector('.verdict') !== null")
    assert.match(await page.evaluate("document.getElementById('task-report').shadowRoot.textContent"), /Passed: 1 of 1/)
    await shoot(page, 'keyboard-report')
    await checkLayout(page, 'report')
    await page.keyboard.press('Escape')
  })
  assert.deepEqual(faults, [])
} finally {
  await browser.close()
  await stop(view)
  await stop(server)
}
console.log('passed')

/** Takes the needle with its key. */
async function byKey(page) {
  await page.evaluate('document.activeElement.blur()')
  await page.keyboard.press('t')
}
