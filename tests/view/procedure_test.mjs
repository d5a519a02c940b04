/* Tests procedure mode with a live server, using the page as a new user would: chooses hole C3.5, inserts the needle, drops a seed, and draws the needle
   back. Run by test_view.sh in a private network.
   usage: procedure_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { writeFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkAccess, checkInView, checkPlaces, driven, faults, hold, holeOnScreen, open, pressUntil, PICTURES, shoot as shootPage, until } from './page.mjs'
import { source, start, stop } from './parts.mjs'

const ARRANGEMENTS = ['1280 x 720', '1024 x 768', '768 x 1024', '390 x 844', '844 x 390'] // one size of each that the style sheet distinguishes
const SIZES = [[1280, 720], [1366, 768], [1280, 800], [1024, 768], [1440, 900], [1680, 1050], [1920, 1080], [768, 1024], [390, 844], [844, 390]]
const NEEDED = '#next, #answer, #hole, #drop, #undo, #fresh, #take, #lever, #pad, #roll, #reset, #drive-note' // without scrolling
const OUT = process.argv[4]
const pelvis = path.join(source, 'meshes/pelvis.yaml')
const text = (id) => `document.getElementById('${id}').textContent`
const says = (id, pattern) => until(page, `${pattern}.test(${text(id)})`)
const tip = () => page.evaluate('trocar.stage.needles[0].tip.toArray()')

let shots = 0
const shoot = (name) => shootPage(page, `procedure-${++shots}-${name}`)

const press = (key, done) => pressUntil(page, key, done, 30)

/* The plan has two seeds in C3.5, which is 4 columns to the patient's right of the middle hole and 1 row below it, with 5 mm per column and row, and another
   seed elsewhere. */
const plan = path.join(OUT, 'plan.csv')
await writeFile(plan, 'hole,seed,x [m],y [m],z [m]\nC3.5,1,0.02,-0.005,0.05875\nC3.5,2,0.02,-0.005,0.04875\nF4,1,0.005,0,0.06\n')
let view = await start('clients/view/trocar-view', '--scene', pelvis, '--plan', plan), server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', pelvis)
  page = await open({ width: 900, height: 600 })

  await check('the page has the images, the grid and a first step', async () => {
    await until(page, `${text('link')} === 'live' && document.body.classList.contains('procedure')`)
    await says('next', /Click on a hole/)
    await until(page, `/Dose of 0 seeds/.test(${text('dose')})`)
    assert.match(await page.evaluate(text('dose')), /prostate 33 cm³/) // both zones: 26 and 7 cm³
    await shoot('start')
  })

  await check('a name that is no hole is refused with the names that are', async () => {
    await page.fill('#hole', 'Q9')
    await page.press('#hole', 'Enter')
    await says('answer', /no hole “Q9”: type a letter from A to M and a number from 1 to 7 in halves/)
  })

  await check('letters of a hole may be small', async () => {
    await page.fill('#hole', ' g4')
    await page.press('#hole', 'Enter')
    await says('next', /G4 is chosen/)
  })

  await check('a click in the grid chooses C3.5', async () => {
    await page.mouse.click(...await holeOnScreen(page, 'C3.5'))
    assert.equal(await page.inputValue('#hole'), 'C3.5')
    await says('next', /C3.5 is chosen/)
    await says('target', /^C3.5, 86.0 mm/) // from the template to the far end of the deepest planned seed
    await shoot('hole')
  })

  await check('hole and target are the same after the connection was lost', async () => {
    await page.evaluate('trocar.procedure.setTarget(trocar.procedure.template.onAxis(trocar.procedure.hole, 0.08))')
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
    await until(page, '(({ x, y, z }) => Math.abs(x - 0.020) < 1e-4 && Math.abs(y + 0.005) < 1e-4 && z < -0.025)(trocar.stage.needles[0].tip)')
    await shoot('in-front')
  })

  await check('a seed is not dropped outside the tissue, and the page says so', async () => {
    await page.click('#drop')
    await says('answer', /No seed dropped: the tip of needle 0 is outside the tissue/)
  })

  await driven('W pushes the needle through the hole to the target', page, async () => {
    // Stops well short of the target: on a busy machine, the page sees the needle up to a second late, and must not push it out on the far side.
    await press('w', `trocar.procedure.tipError(trocar.stage.needles[0].tip).along < 0.018`)
    await says('needles', /driven hereC3.5/)
    assert((await tip())[2] > 0.04)
    await shoot('at-target')
  })

  await driven('a seed is dropped, and stays when the needle is drawn back', page, async () => {
    const left = 'trocar.procedure.seeds.seeds.length === 1'
    if (await page.evaluate(`!trocar.procedure.seeds.pending[0] && !(${left})`)) { // false if the check is repeated after the seed has been dropped
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
    await says('target', /^C3.5, 76.0 mm/) // the target is now the next planned seed
    await page.uncheck('#follow')
    await page.evaluate('trocar.echo.setPlace(trocar.procedure.seeds.seeds[0].position[2])')
    await until(page, '!trocar.echo.dirty && !trocar.procedure.sagittal.dirty')
    await shoot('dose')
  })

  await driven('Undo takes the seed and its dose back', page, async () => {
    await press('u', 'trocar.procedure.seeds.seeds.length === 0')
    await says('answer', /The last seed is taken back/)
    await until(page, `/Dose of 0 seeds/.test(${text('dose')})`)
    await says('target', /^C3.5, 86.0 mm/) // the target is the first planned seed again
  })

  await driven('a strand is dropped, and taken back while it is in the needle', page, async () => {
    await press('w', `trocar.procedure.tipError(trocar.stage.needles[0].tip).along < 0.018`) // a busy page draws back too far, where a strand does not fit
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
    await page.click('#take') // releases the second needle
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
      server.kill('SIGCONT') // a stopped process would not react to SIGTERM
    }
    await until(page, `trocar.status.alive && ${text('link')} === 'live'`)
  })

  await check('a phone or tablet is told of the lever and of no keys', async () => {
    const phone = await open({ width: 390, height: 844 }, { hasTouch: true, isMobile: true })
    await until(phone, `${text('link')} === 'live' && document.body.classList.contains('procedure')`)
    await phone.evaluate("trocar.procedure.choose(trocar.procedure.template.find('G4'))")
    const said = await phone.evaluate(`(${allSteps})()`)
    for (const words of said) assert(!/\b[WS]\b|Shift/.test(words), words)
    assert(said.some((words) => /lever/.test(words)), `${said}`)
    await phone.context().close()
  })

  await check('a tip or a seed that is not in the gland is told', async () => {
    assert.match(await page.evaluate("trocar.procedure.outOfTarget(-1)"), /It is not in the prostate, nor in the tissue/)
    const organs = await page.evaluate('trocar.stage.scene.regions.map(({ organ }) => organ)')
    assert.equal(organs.filter((organ) => organ === 'prostate').length, 2) // both zones of the gland
    const said = await page.evaluate(`(${wordsForRegions})()`)
    for (const [i, organ] of organs.entries()) {
      if (organ === 'prostate') assert.equal(said[i], '')
      else assert(said[i].includes(`in “${organ}”`), said[i])
    }
    assert.match(await page.evaluate(`(${throughTheTissue})()`), /come out of the tissue on its far side/)
  })

  await check('the page says when a hole is done, which one is next, and when all are done', async () => {
    const [inside, outside, undone, all, judged] = await page.evaluate(`(${planSteps})()`)
    assert.match(inside, /^Hole C3\.5 is done\. Draw the needle out .* Next: hole F4\.$/)
    assert.match(outside, /^Hole C3\.5 is done\. Next: hole F4\.$/)
    assert.match(undone, /mm to the target|Press “Drop seed”/)
    assert.match(all, /^Hole F4 is done\. All planned seeds are in the tissue\.$/)
    assert.match(judged, /^Hole F4 is done\. .*“Finish and see the report”\.$/)
  })

  await check('the page says when a target is reached, passed or left, and forgets it when a task begins', async () => {
    const [before, at, past, again, out, open, last, fresh] = await page.evaluate(`(${targetSteps})()`)
    assert.match(before, /^Push on .* 5\.0 mm to the target\./)
    assert.match(at, /^The tip is at the target\. Draw the needle out .* Next: hole F4\.$/)
    assert.match(past, /^Draw the needle back .* 5\.0 mm to the target\./)
    assert.equal(again, at)
    assert.match(out, /^Hole C3\.5 is done\. Next: hole F4\.$/)
    assert.match(open, /^Hole F4 is done\. $/, 'a target without a hole is left')
    assert.match(last, /^Hole F4 is done\. That was the last one: press “Task”/)
    assert(!/done/.test(fresh), fresh)
  })

  await hold(page)
  for (const many of [false, true]) {
    if (many) await page.evaluate(fillWithNeedles)
    for (const [width, height] of SIZES)
      await check(`layout, ${width} x ${height}${many ? ', all needles in use' : ''}`, async () => {
        await page.setViewportSize({ width, height })
        await page.waitForTimeout(300)
        const one = await page.evaluate("document.getElementById('panes').checkVisibility()") // a small screen, which shows one of the panes
        for (const pane of one ? ['axial', 'stage'] : ['axial']) {
          await page.evaluate(`trocar.procedure.choosePane('${pane}')`) // chooses what a small screen shows
          const name = `${width} x ${height}, ${pane}`
          await checkPlaces(page, name)
          if (ARRANGEMENTS.includes(`${width} x ${height}`) && !many) await checkAccess(page, name)
        }
        await page.evaluate("trocar.procedure.choosePane('axial')")
        if (height > 560) await checkInView(page, NEEDED, `${width} x ${height}`)
        else await checkInView(page, '#next, #hole, #drop', `${width} x ${height}`)
        if (height >= 1050) await checkInView(page, '#dose svg[role=img]', `${width} x ${height}`)
        await shoot(`${width}-dark${many ? '-many' : ''}`)
        if (many || !PICTURES) return
        await page.evaluate('trocar.setTheme("light")')
        await page.waitForTimeout(300)
        await shoot(`${width}-light`)
        await page.evaluate('trocar.setTheme("dark")')
      })
  }
  await check('when the server is started anew, the page says that needles and seeds are gone', async () => {
    await stop(server)
    await until(page, `${text('link')} === 'no server'`)
    server = await start('server/trocar-server', '--allow-non-rt', '--scene', pelvis)
    await says('answer', /The server has been restarted: the needles are out\./)
    await until(page, `${text('link')} === 'live' && parseFloat(${text('depth')}) === 0`)
    for (const [seeds, words] of [[1, ', and the seed is gone.'], [3, ', and the 3 seeds are gone.']])
      assert(await page.evaluate(`(trocar.procedure.left = ${seeds}, trocar.procedure.hearRestart(), ${text('answer')}.endsWith('${words}'))`), words)
  })
  assert.deepEqual(faults, [])
} finally {
  await stop(server)
  await stop(view)
  await browser.close()
}

/** Runs in the page. Returns the instructions after both seeds of C3.5, with the needle inside and outside, after one of them, and after all planned seeds, without
 * and with a task. */
function planSteps() {
  const { procedure, stage, chosen } = trocar, { template } = procedure, tip = stage.needles[chosen].tip, said = []
  const { steering } = procedure.drive, before = { seeds: procedure.seeds, hole: procedure.hole, planned: procedure.planned }
  const place = (...holes) => { procedure.seeds = { pending: [], seeds: holes.map((hole) => ({ needle: chosen, guide: template.index, hole: template.number(template.find(hole)), position: [0, 0, 0] })) } }
  const step = (hole, depth) => { procedure.hole = template.find(hole); said.push(procedure.nextStep(tip, depth, chosen, 'held')) }
  procedure.drive.steering = true
  procedure.targetNow ??= tip.clone()
  procedure.planned = true
  place('C3.5', 'C3.5')
  step('C3.5', 0.05)
  step('C3.5', 0)
  place('C3.5')
  step('C3.5', 0.05)
  place('C3.5', 'F4', 'C3.5')
  step('F4', 0)
  procedure.judged = true
  step('F4', 0)
  Object.assign(procedure, before, { judged: false })
  procedure.drive.steering = steering
  return said
}

/** Runs in the page. Returns the instructions for a task with targets in C3.5 and F4, and one without a hole: 5 mm before the first target, at it, 5 mm past it, at it
 * again, and outside; outside after the target in F4, with and without the one without a hole; and outside after a new task has begun. */
function targetSteps() {
  const { procedure, stage, chosen } = trocar, { template } = procedure, said = [], { steering } = procedure.drive
  const before = { plan: procedure.plan, plannedNow: procedure.plannedNow, seeds: procedure.seeds, hole: procedure.hole, targetNow: procedure.targetNow, planned: procedure.planned, shown: null }
  const step = (hole, along, depth) => {
    procedure.hole = template.find(hole)
    procedure.targetNow = procedure.plannedNow[procedure.plan.findIndex((entry) => entry.hole === hole)].clone()
    const tip = procedure.targetNow.clone().addScaledVector(template.normal, -along)
    procedure.noteVisits(tip, depth)
    said.push(procedure.nextStep(tip, depth, chosen, 'held'))
  }
  const targets = ['C3.5', 'F4'].map((hole) => ({ hole, position: template.onAxis(template.find(hole), 0.08).toArray() }))
  const take = (list) => { procedure.hearTargets(list); procedure.plannedNow = procedure.plan.map(({ point }) => point.rest.clone()) }
  Object.assign(procedure, { seeds: { pending: [], seeds: [] }, judged: true })
  procedure.drive.steering = true
  take([...targets, { hole: 'Z9', position: targets[0].position }])
  for (const along of [0.005, 0, -0.005, 0]) step('C3.5', along, 0.05)
  step('C3.5', 0, 0)
  step('F4', 0, 0.05)
  step('F4', 0, 0)
  said.splice(5, 1)
  procedure.plan.pop()
  step('F4', 0, 0)
  procedure.beginTask()
  step('F4', 0, 0)
  Object.assign(procedure, before, { judged: false, seedless: false })
  procedure.drive.steering = steering
  return said
}

/** Runs in the page. Returns the instructions that the page gives for each state of the needle. */
function allSteps() {
  const { procedure, stage, chosen } = trocar, tip = stage.needles[chosen].tip, said = []
  const { steering } = procedure.drive, far = procedure.targetNow
  procedure.drive.steering = true
  for (const depth of [0, 0.05])
    for (const isThrough of [false, true])
      for (const pending of [0, 1])
        for (const along of [-0.01, 0, 0.01]) {
          procedure.isThrough = isThrough
          procedure.seeds = { pending: [pending], seeds: [] }
          procedure.targetNow = tip.clone().addScaledVector(procedure.template.normal, along)
          said.push(procedure.nextStep(tip, depth, chosen, 'held'))
        }
  Object.assign(procedure, { isThrough: false, seeds: { pending: [], seeds: [] }, targetNow: far })
  procedure.drive.steering = steering
  return [...said, document.getElementById('drive-note').textContent]
}

/** Runs in the page. Returns the page's text about a seed in the first tetrahedron of each region. */
function wordsForRegions() {
  const { procedure, stage: { scene } } = trocar
  const first = ({ group }) => scene.tets.findIndex((value, i) => i % 5 === 0 && value === group) / 5
  return scene.regions.map((region) => procedure.outOfTarget(first(region)))
}

/** Runs in the page. Returns the next step for a needle whose tip is beyond the tissue. */
function throughTheTissue() {
  const { procedure, stage, chosen } = trocar
  procedure.choose(procedure.template.find('G4'))
  const beyond = stage.needles[chosen].tip.clone().setZ(0.5), { steering } = procedure.drive
  procedure.noteTip(beyond, 0.1)
  procedure.drive.steering = true
  const said = procedure.nextStep(beyond, 0.1, chosen, 'held')
  const stopped = procedure.drive.limit() === 0
  procedure.drive.steering = steering
  procedure.noteTip(stage.needles[chosen].tip, 0)
  return stopped ? said : 'it is not stopped'
}

/** Runs in the page. Marks all needles except the driven one as resting in the tissue. */
function fillWithNeedles() {
  const { procedure } = trocar, describe = procedure.describe.bind(procedure)
  procedure.isInUse = () => true
  procedure.isFree = (needle) => needle !== procedure.drive.needle
  procedure.describe = (status, ...more) => describe({ ...status, needles: status.needles?.map((each, i) => (i === procedure.drive.needle ? each : { ...each, state: 'resting' })) }, ...more)
}
