/* Tests a trainee's task with a live server: the page says what to do, the needle is brought to the target, and the report has the same numbers as
   trocar-score gives for the recording. Run by test_view.sh in a private network.
   usage: task_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { execFileSync, spawnSync } from 'node:child_process'
import { mkdir, readdir, readFile, rmdir, writeFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkAccess, checkLayout, checkReport, driven, faults, open, pressUntil, shoot, until } from './page.mjs'
import { ready, run, source, start, stop } from './parts.mjs'

const [build, , OUT] = process.argv.slice(2)
const implant = path.join(source, 'meshes/implant.yaml'), runs = path.join(OUT, 'runs'), task = path.join(OUT, 'reach.yaml')
const text = (id) => `document.getElementById('${id}').textContent`
const says = (id, pattern) => until(page, `${pattern}.test(${text(id)})`)
await writeFile(task, `title: Reach it
text: Bring the tip to the target.
scene: ${implant}
targets: [{name: target, position: [0.010, -0.005, 0.045], hole: E3.5}]
organs: {gland: [prostate]}
criteria:
  - {measure: passes, most: 1, source: a choice}
  - {measure: tip_error, most: 1e-4, source: too strict}
hints: [Do not hurry.]
`)
const score = (...options) => spawnSync(path.join(build, 'clients/view/trocar-score'), options, { encoding: 'utf8' })

let view = await ready(run('clients/view/trocar-view', '--task', task, '--runs', runs)), server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', implant)
  page = await open({ width: 1280, height: 800 })

  await check('the page says what to do', async () => {
    await until(page, `${text('link')} === 'live' && document.getElementById('task').open`)
    assert.equal(await page.evaluate(text('task-title')), 'Reach it')
    assert.match(await page.evaluate(text('task-criteria')), /at most 0\.1 mm \(too strict\)/)
    assert.match(await page.evaluate(text('task-hints')), /Do not hurry/)
    await checkLayout(page, 'task')
    await shoot(page, 'task-1-start')
  })

  await check('Start starts the time', async () => {
    await page.click('#task-start')
    await until(page, `!document.getElementById('task').open && /^Task 0:0[1-9]/.test(${text('task-button')})`)
  })

  await driven('the target of the task is the target of the page, and the needle is pushed to it', page, async () => {
    await page.fill('#hole', 'E3.5')
    await page.press('#hole', 'Enter')
    await says('target', /^E3.5, 70.0 mm/)
    for (let times = 0; times < 30 && !await page.evaluate('trocar.procedure.tipError(trocar.stage.needles[0].tip)?.along < 0.004'); times++) {
      await page.keyboard.down('w')
      for (const end = Date.now() + 1500; Date.now() < end && !await page.evaluate('trocar.procedure.tipError(trocar.stage.needles[0].tip)?.along < 0.004');) await page.waitForTimeout(30)
      await page.keyboard.up('w')
    }
    await shoot(page, 'task-2-at-target')
  })

  await check('Finish shows the report', async () => {
    await page.click('#task-button')
    await page.click('#task-finish')
    await until(page, "document.getElementById('task-report').shadowRoot.querySelector('.verdict') !== null")
    const words = await page.evaluate("document.getElementById('task-report').shadowRoot.textContent")
    assert.match(words, /Not passed: 1 of 2 criteria are met/)
    await page.evaluate("document.getElementById('task').scrollTo(0, 300)")
    await shoot(page, 'task-3-report')
    const shown = await page.evaluate("[...document.getElementById('task-report').shadowRoot.querySelectorAll('img')].map((image) => image.complete && image.naturalWidth > 0)")
    assert.deepEqual(shown, [true, true])
    await checkAccess(page, 'report in the page')
  })

  await check('the report has the numbers of trocar-score for the recording, to the digit', async () => {
    const files = (await readdir(path.join(runs, 'reach'))).sort(), [name] = files[0].split('.')
    assert.deepEqual(files.map((file) => path.extname(file)), ['.csv', '.html', '.json', '.log'])
    const log = path.join(runs, 'reach', files.find((file) => file.endsWith('.log'))), again = path.join(OUT, 'again.json')
    const { status } = score(log, '--task', task, '--json', again)
    assert.equal(status, 1)
    const live = await readFile(log.replace(/log$/, 'json'), 'utf8')
    assert.equal(live, await readFile(again, 'utf8'))
    const { measures } = JSON.parse(live)
    assert.equal(measures.passes, 1)
    assert(measures.tip_error > 1e-4 && measures.tip_error < 0.02 && measures.force > 5 && measures.time > 0.5, live)
    const replayed = path.join(OUT, 'replayed.csv') // checks that the recording can be replayed
    execFileSync(path.join(build, 'clients/trocar-replay'), ['--scene', implant, '--poses', log, '--csv', replayed])
    assert((await readFile(replayed, 'utf8')).split('\n').length > 100)
    assert(name)
  })

  await check('a seed is left in the tissue', async () => {
    await page.click('#task-close')
    await page.click('#drop')
    await until(page, 'trocar.procedure.seeds.pending[0] === 1')
    await pressUntil(page, 's', 'trocar.procedure.seeds.seeds.length === 1')
  })

  await check('starting again, on a German page, removes needle and seed, and the new recording contains neither', async () => {
    await page.context().close()
    page = await open({ width: 1024, height: 768 }, { locale: 'de-DE' })
    await until(page, `${text('link')} === 'live' && document.getElementById('task').open`) // with the report of the last run
    await says('task-message', /Beim Start werden alle Nadeln und Seeds/)
    await checkLayout(page, 'task in German')
    await page.click('#task-start')
    await until(page, `!document.getElementById('task').open && /^Aufgabe 0:0[0-9]/.test(${text('task-button')})`)
    await until(page, 'trocar.procedure.seeds.seeds.length === 0 && trocar.history.columns[7][trocar.history.count - 1] === 0')
    await page.click('#task-button')
    await page.click('#task-finish')
    await until(page, "/Nicht bestanden/.test(document.getElementById('task-report').shadowRoot.textContent)")
    await checkAccess(page, 'German report in the page')
    await shoot(page, 'task-4-german')
    const report = (await readdir(path.join(runs, 'reach'))).filter((file) => file.endsWith('.json')).sort().at(-1)
    const { measures } = JSON.parse(await readFile(path.join(runs, 'reach', report), 'utf8'))
    assert(measures.passes === 0 && measures.path === 0 && measures.displacement < 1e-6, JSON.stringify(measures))
  })

  await check('a report that cannot be written is not shown, and the page says why', async () => {
    const folder = path.join(runs, 'reach'), before = await readdir(folder)
    await page.click('#task-start')
    await until(page, "!document.getElementById('task').open")
    const [log] = (await readdir(folder)).filter((file) => !before.includes(file)), taken = path.join(folder, log.replace(/log$/, 'html'))
    await mkdir(taken) // in the place of the report
    await page.click('#task-button')
    await page.click('#task-finish')
    await says('task-message', /\.html: Is a directory/)
    assert.equal(await page.evaluate("document.getElementById('task-html').hidden && document.getElementById('task-report').shadowRoot.childElementCount"), 0)
    await rmdir(taken)
    await page.click('#task-start')
    await until(page, "!document.getElementById('task').open")
    await page.click('#task-button')
    await page.click('#task-finish')
    await until(page, "/Nicht bestanden/.test(document.getElementById('task-report').shadowRoot.textContent)")
  })

  await check('without a server, it does not start, and the report stays', async () => {
    await stop(server)
    server = null
    await until(page, '!trocar.status.alive')
    await page.click('#task-start')
    await says('task-message', /Kein Server/)
    assert.match(await page.evaluate("document.getElementById('task-report').shadowRoot.textContent"), /Nicht bestanden/)
  })

  await check('axe-core finds no violations in saved reports', async () => {
    const pages = (await readdir(path.join(runs, 'reach'))).filter((file) => file.endsWith('.html'))
    assert.equal(pages.length, 3)
    for (const file of pages) {
      await page.goto(`file://${path.join(runs, 'reach', file)}`)
      await checkReport(page, file)
    }
  })

  assert.deepEqual(faults, [])
} finally {
  await browser.close()
  await stop(view)
  if (server) await stop(server)
}

/* A bad task ends trocar-view with the message of trocar-score. */
await writeFile(task, 'title: Nothing\n')
const bad = spawnSync(path.join(build, 'clients/view/trocar-view'), ['--task', task, '--runs', runs], { encoding: 'utf8' })
assert.equal(bad.status, 2)
assert.match(bad.stderr, /trocar-view: --task: trocar-score: .*reach.yaml:1: missing key "text"/)
