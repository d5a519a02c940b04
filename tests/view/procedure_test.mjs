// Procedure mode with a live server, as someone new to it uses the page: hole C3.5, needle in, seed dropped, needle drawn back. Run by
// test_view.sh in a private network.
// usage: procedure_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR
import assert from 'node:assert/strict'
import { writeFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkLayout, driven, faults, hold, open, until } from './page.mjs'
import { source, start, stop } from './parts.mjs'

const SIZES = [[1440, 900], [1280, 720], [1024, 768], [390, 844]]
const OUT = process.argv[4]
const implant = path.join(source, 'meshes/implant.yaml')
const text = (id) => `document.getElementById('${id}').textContent`
const says = (id, pattern) => until(page, `${pattern}.test(${text(id)})`)
const tip = () => page.evaluate('trocar.stage.needles[0].tip.toArray()')

let shots = 0
/** A picture of the page, for people to look at. */
const shoot = (name) => page.screenshot({ path: path.join(OUT, `procedure-${++shots}-${name}.png`) })

/** The middle of a hole on the screen. */
const onScreen = (hole) => page.evaluate((name) => {
  const { procedure, echo } = trocar, { template } = procedure, place = template.place(template.find(name)), box = echo.canvas.getBoundingClientRect()
  const [x, y] = echo.toPixel(place.x, place.y), ratio = echo.marks.width / box.width
  return [box.left + x / ratio, box.top + y / ratio]
}, hole)

/** Holds a key down until the expression is true. On a busy machine the page may stop the needle meanwhile, and then wants the key pressed again. */
const press = async (key, done) => {
  for (let times = 0; times < 30 && !await page.evaluate(done); times++) {
    await page.keyboard.down(key)
    for (const end = Date.now() + 3000; Date.now() < end && !await page.evaluate(done);) await page.waitForTimeout(30)
    await page.keyboard.up(key)
  }
  await until(page, done)
}

// Two planned seeds in C3.5, which is 4 columns to the patient's right of the middle one and 1 row below it, 5 mm each; another one elsewhere.
const plan = path.join(OUT, 'plan.csv')
await writeFile(plan, 'hole,seed,x [m],y [m],z [m]\nC3.5,1,0.02,-0.005,0.05875\nC3.5,2,0.02,-0.005,0.04875\nF4,1,0.005,0,0.06\n')
let view = await start('clients/view/trocar-view', '--scene', implant, '--plan', plan), server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', implant)
  page = await open({ width: 900, height: 600 })

  await check('the page has the images, the grid and a first step', async () => {
    await until(page, `${text('link')} === 'live' && document.body.classList.contains('procedure')`)
    await says('next', /Click on a hole/)
    await until(page, `/Dose of 0 seeds/.test(${text('dose')})`)
    await shoot('start')
  })

  await check('a name that is no hole is refused with the names that are', async () => {
    await page.fill('#hole', 'Q9')
    await page.press('#hole', 'Enter')
    await says('answer', /no hole “Q9”: type a letter from A to M and a number from 1 to 7 in halves/)
  })

  await check('a click in the grid chooses C3.5', async () => {
    await page.mouse.click(...await onScreen('C3.5'))
    assert.equal(await page.inputValue('#hole'), 'C3.5')
    await says('next', /C3.5 is chosen/)
    await says('target', /^C3.5, 86.0 mm/) // the far end of the deepest planned seed, 25 mm in front of which the template begins
    await shoot('hole')
  })

  await check('hole and target are the same after the connection was lost', async () => {
    await page.evaluate('trocar.procedure.setTarget(0.08)')
    await says('target', /^C3.5, 80.0 mm/)
    await page.evaluate('trocar.procedure.link.socket.close()')
    await until(page, `${text('link')} === 'no connection'`)
    await until(page, `${text('link')} === 'live'`)
    await says('target', /^C3.5, 80.0 mm/)
    await page.evaluate('trocar.procedure.choose(trocar.procedure.hole)')
    await says('target', /^C3.5, 86.0 mm/)
  })

  await driven('the driven needle moves in front of the hole', page, async () => {
    await says('next', /Hold W/)
    const [x, y, z] = await tip()
    assert(Math.abs(x - 0.020) < 1e-4 && Math.abs(y + 0.005) < 1e-4 && z < -0.025, `${[x, y, z]}`)
    await shoot('in-front')
  })

  await check('a seed is not dropped outside of the tissue, and the page says so', async () => {
    await page.click('#drop')
    await says('answer', /No seed dropped: the tip of needle 0 is outside of the tissue/)
  })

  await driven('W pushes the needle through the hole to the target', page, async () => {
    // Well in front of the target: a page on a busy machine sees the needle up to a second late, and must not push it out of the far side.
    await press('w', `trocar.procedure.tipError(trocar.stage.needles[0].tip).along < 0.018`)
    await says('needles', /driven hereC3.5/)
    assert((await tip())[2] > 0.04)
    await shoot('at-target')
  })

  await driven('a seed is dropped, and stays when the needle is drawn back', page, async () => {
    const left = 'trocar.procedure.seeds.seeds.length === 1'
    if (await page.evaluate(`!trocar.procedure.seeds.pending[0] && !(${left})`)) { // else this is repeated
      await page.click('#drop')
      await says('answer', /The seed is at the tip/)
      await says('next', /Draw the needle back 4\.\d mm/)
      await shoot('dropped')
    }
    await press('s', left)
    await says('answer', /Seed 1 is in the tissue/)
    const [seed] = await page.evaluate('trocar.procedure.seeds.seeds.map(({ hole, restPosition }) => ({ hole, place: [...restPosition] }))')
    assert.equal(seed.hole, 2 + 13 * 5, 'in C3.5')
    assert(Math.hypot(seed.place[0] - 0.020, seed.place[1] + 0.005) < 0.003, `${seed.place}`)
  })

  await check('its dose is drawn and summed up', async () => {
    await until(page, `/Dose of 1 seed/.test(${text('dose')}) && trocar.procedure.dose.seeds === 1 && trocar.echo.doses.doseTop.value > 0`)
    await says('target', /^C3.5, 76.0 mm/) // the next planned seed
    await page.uncheck('#follow')
    await page.evaluate('trocar.echo.setPlace(trocar.procedure.seeds.seeds[0].position[2])')
    await until(page, '!trocar.echo.dirty && !trocar.procedure.sagittal.dirty')
    await shoot('dose')
  })

  await driven('Undo takes the seed and its dose back', page, async () => {
    await press('u', 'trocar.procedure.seeds.seeds.length === 0')
    await says('answer', /The last seed is taken back/)
    await until(page, `/Dose of 0 seeds/.test(${text('dose')})`)
    await says('target', /^C3.5, 86.0 mm/) // again the first planned seed
  })

  await driven('a strand is dropped, and taken back while it is in the needle', page, async () => {
    await page.selectOption('#strand', '2')
    await page.click('#drop')
    await until(page, 'trocar.procedure.seeds.pending[0] === 2')
    await says('next', /to leave the strand of 2/)
    await press('u', 'trocar.procedure.seeds.pending[0] === 0')
    await page.selectOption('#strand', '1')
  })

  await driven('the needle is left in, and rests', page, async () => {
    if (!await page.evaluate("trocar.procedure.states[0].state === 'resting'")) await page.keyboard.press('e')
    await until(page, "trocar.procedure.states[0].state === 'resting' && !trocar.status.drives")
    await says('needles', /0restingC3.5/)
    await says('next', /Needle 0 rests/)
    await shoot('resting')
  })

  await check('a new needle goes to another hole, and not to a taken one', async () => {
    await page.click('#fresh')
    await until(page, 'trocar.status.drives && trocar.status.needle === 1 && trocar.chosen === 1')
    await page.fill('#hole', 'C3.5')
    await page.press('#hole', 'Enter')
    await says('answer', /Needle 0 is in hole C3.5/)
    await page.fill('#hole', 'G4')
    await page.press('#hole', 'Enter')
    await until(page, 'Math.abs(trocar.stage.needles[1].tip?.x ?? 1) < 1e-4 && trocar.stage.needles[1].tip.z > -0.05')
    await shoot('second-needle')
  })

  await check('the resting needle is taken again where it is, and pulled out when it rests', async () => {
    const lies = await page.evaluate('trocar.stage.needles[0].tip.z')
    await page.click('#take') // lets go of the second one
    await until(page, '!trocar.status.drives')
    await page.click('button[aria-label="Take needle 0"]')
    await until(page, "trocar.status.drives && trocar.status.needle === 0 && trocar.status.state === 'held'")
    await says('answer', /Needle 0 is held again/)
    assert(Math.abs(await page.evaluate('trocar.stage.needles[0].tip.z') - lies) < 1e-3)
    await page.keyboard.press('e')
    await until(page, "trocar.procedure.states[0].state === 'resting' && !trocar.status.drives")
    await page.click('button[aria-label="Pull out needle 0"]')
    await says('answer', /Needle 0 is out/)
    await until(page, `!/0restingC3.5/.test(${text('needles')})`)
  })

  await hold(page)
  await check('a server that is silent for a moment leaves the chosen needle as it is', async () => {
    const chosen = await page.evaluate('trocar.chosen')
    server.kill('SIGSTOP')
    try {
      await until(page, '!trocar.status.alive')
      assert.deepEqual(await page.evaluate('[trocar.status.needle, trocar.chosen]'), [chosen, chosen])
    } finally {
      server.kill('SIGCONT') // a stopped process would not end, either
    }
    await until(page, `trocar.status.alive && ${text('link')} === 'live'`)
  })

  await hold(page)
  for (const [width, height] of SIZES)
    await check(`layout, ${width} x ${height}`, async () => {
      await page.setViewportSize({ width, height })
      await page.waitForTimeout(300)
      await checkLayout(page, `${width} x ${height}`)
      await shoot(`${width}-dark`)
      await page.evaluate('trocar.setTheme("light")')
      await page.waitForTimeout(300)
      await shoot(`${width}-light`)
      await page.evaluate('trocar.setTheme("dark")')
    })
  assert.deepEqual(faults, [])
} finally {
  await stop(server)
  await stop(view)
  await browser.close()
}
