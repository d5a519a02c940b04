/* Tests the page with a live server, as a person would use it, in headless Chromium. Run by test_view.sh in a private network.
   usage: live_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { once } from 'node:events'
import { readFile, writeFile } from 'node:fs/promises'
import { connect } from 'node:net'
import path from 'node:path'
import { browser, check, checkLayout, driven, faults, open, shoot, until } from './page.mjs'
import { ADDRESS, run, scene, source, start, stop } from './parts.mjs'

// the last size is that of a 1024 x 768 screen with the page zoomed to 150 %
const SIZES = [[390, 844], [844, 390], [1280, 720], [1366, 768], [1280, 800], [1024, 768], [1440, 900], [1680, 1050], [1920, 1080], [768, 1024], [683, 512]]
const SMALL = { width: 500, height: 400 } // small, so that it is drawn quickly
const startServer = () => start('server/trocar-server', '--allow-non-rt')
const badge = (text) => `document.getElementById('link').textContent === '${text}'`
const banner = (text) => `!document.getElementById('banner').hidden && document.getElementById('banner').textContent.includes('${text}')`
const graphicsHeld = '[trocar.stage, trocar.echo].map(({ renderer }) => ({ ...renderer.info.memory }))'
const tip = (page) => page.evaluate('trocar.stage.needles[0].tip?.z')

let view = await start('clients/view/trocar-view'), server, first, second
try {
  first = await open()
  await check('the page shows the anatomy without a server', async () => {
    await until(first, badge('no server'))
    const written = /\$Nodes\s+(\d+)/.exec(await readFile(path.join(source, 'meshes/prostate.msh'), 'latin1'))
    assert.equal(await first.evaluate('trocar.stage.scene.nodes.length / 3'), Number(written[1]))
    for (const layer of ['body', 'prostate', 'capsule', 'bone']) assert(await first.evaluate(`trocar.stage.anatomy.layers.has('${layer}')`), layer)
    assert.equal(await first.evaluate('trocar.history.pictures.length'), 0)
    await until(first, 'document.getElementById("scale-bar").clientWidth > 40')
    assert(await tip(first) < 0, 'the needle waits outside')
  })

  for (const [width, height] of [[390, 844], [844, 390], [1024, 768]])
    await check(`layout without a server, ${width} x ${height}`, async () => {
      await first.setViewportSize({ width, height })
      await first.waitForTimeout(300)
      await checkLayout(first, `${width} x ${height}`)
    })
  await first.setViewportSize({ width: 1000, height: 640 })

  await check('a server that starts is seen', async () => {
    server = await startServer()
    await until(first, badge('live'))
  })

  await check('a double click takes the needle once', async () => {
    const before_it = await first.locator('#take').boundingBox()
    await first.dblclick('#take')
    await until(first, 'trocar.status.drives && trocar.status.owned === "here" && trocar.shown !== null')
    const reset = await first.locator('#reset').boundingBox()
    assert(reset.y + reset.height < before_it.y - 100, 'Reset is far from where the needle is taken')
  })

  await driven('keys drive the needle into the tissue', first, async () => {
    const before = await tip(first)
    await first.keyboard.down('w')
    await until(first, `trocar.shown.needles[0].contacts.length / 9 >= 5 && trocar.stage.needles[0].tip.z > ${before} + 0.01`)
    await first.keyboard.up('w')
    await until(first, 'trocar.history.columns[7][trocar.history.count - 1] > 0.01')
    assert(await first.evaluate('trocar.shown.displacement.some((count) => count !== 0)'), 'the tissue moves')
    assert(await first.evaluate('trocar.history.marks.some((mark) => mark.name === "skin")'), 'the puncture is marked')
    await until(first, '!document.getElementById("track-key").hidden') // the legend shows the track
  })

  await driven('a key released after the needle was released moves nothing', first, async () => {
    await first.keyboard.down('w')
    await until(first, 'trocar.drive.command()[2] === 1')
    await first.click('#take')
    await until(first, '!trocar.status.drives')
    await first.keyboard.up('w')
    await first.click('#take')
    await until(first, 'trocar.status.drives && trocar.status.owned === "here"')
    assert.deepEqual(await first.evaluate('trocar.drive.command()'), [0, 0, 0, 0, 0, 0])
    const shownBase = () => first.evaluate('[trocar.shown.tick, trocar.shown.needles[0].joints[2]]')
    const [taken] = await shownBase() // this base may be from a frame made while the needle was still driven
    await until(first, `trocar.shown.tick > ${taken} + 1000`)
    const [tick, base] = await shownBase()
    await until(first, `trocar.shown.tick > ${tick} + 200`)
    assert(Math.abs((await shownBase())[1] - base) < 1e-6, 'the base rests')
  })

  await driven('numbers and plots follow', first, async () => {
    await until(first, 'parseFloat(document.getElementById("depth").textContent) > 10')
    const points = await first.evaluate('trocar.plots.plots[0].chart.data[0].length')
    await until(first, `trocar.plots.plots[0].chart.data[0].at(-1) > ${await first.evaluate('trocar.plots.plots[0].chart.data[0].at(-1)')}`)
    assert(points > 10)
  })

  await driven('pause and scrub show the past, and live returns', first, async () => {
    const now = await tip(first)
    await first.evaluate('trocar.seek(trocar.history.start)')
    await until(first, `trocar.stage.needles[0].tip.z < ${now} - 0.005`)
    await until(first, `${badge('past')} && ${banner('Past')} && getComputedStyle(document.getElementById('view')).opacity === '0.7'`)
    await first.keyboard.down('w') // the needle cannot be driven while the page shows the past
    assert.deepEqual(await first.evaluate('trocar.drive.command()'), [0, 0, 0, 0, 0, 0])
    await first.keyboard.up('w')
    assert(await first.evaluate('trocar.status.drives'), 'the needle is still held')
    await first.click('#banner button')
    await until(first, `Math.abs(trocar.stage.needles[0].tip.z - ${now}) < 1e-3 && ${badge('live')} && document.getElementById('banner').hidden`)
  })

  await check('messages of the server are shown', async () => {
    const device = run('clients/trocar-device', '--duration', '0.5')
    await until(first, '/server: .*session.* holds the needle/.test(document.getElementById("notice").textContent)')
    await stop(device)
  })

  second = await open({ width: 700, height: 900 })
  await driven('a second browser sees the same and cannot take the needle', first, async () => {
    await until(second, 'trocar.shown !== null && trocar.status.driven')
    const [here, there] = [await tip(first), 'trocar.stage.needles[0].tip?.z']
    await until(second, `Math.abs(${there} - ${here}) < 1e-4`) // the needle is at rest
    await until(second, 'document.getElementById("take").disabled')
    await until(second, 'trocar.history.count > 50') // the page also gets plot data from before it connected
    await second.setViewportSize(SMALL)
  })

  await check("a task's targets are drawn in a scene without a template", async () => {
    const drawn = 'trocar.procedure.models.planned.count'
    await first.evaluate("trocar.procedure.hearTargets([{ name: 'a', position: [0, 0, 0.05], hole: '' }])")
    await until(first, `${drawn} === 1 && Math.abs(trocar.procedure.plannedNow[0].z - 0.05) < 0.01`)
    await first.evaluate('trocar.procedure.setPlan([])')
    await until(first, `${drawn} === 0`)
  })

  await check('every layer and cut draws', async () => {
    for (const axis of ['x', 'y', 'z', '']) {
      await first.selectOption('#cut-axis', axis)
      await until(first, '!trocar.stage.dirty')
    }
    for (let times = 0; times < 2; times++) { // off and on
      await first.evaluate('document.querySelectorAll("#layer-list input").forEach((box) => box.click())')
      await until(first, '!trocar.stage.dirty')
    }
    await first.keyboard.press('n')
    await until(first, 'document.documentElement.dataset.theme === "light" && !trocar.stage.dirty')
  })

  await driven('a gamepad and the lever on the page also drive the needle', first, async () => {
    const back = await tip(first)
    await first.evaluate(() => { navigator.getGamepads = () => [null, { axes: [0, 0, 0, 0], buttons: [0, 0, 0, 0, 0, 0, 1, 0].map((value) => ({ value })) }] })
    await until(first, `trocar.stage.needles[0].tip.z < ${back} - 0.005`) // the left trigger pulls the needle back
    await first.evaluate(() => { navigator.getGamepads = () => [] })
    const lever = await first.locator('#lever').boundingBox(), out = await tip(first)
    await first.mouse.move(lever.x + lever.width / 2, lever.y + lever.height / 2)
    await first.mouse.down()
    await first.mouse.move(lever.x + lever.width / 2, lever.y + 10)
    await until(first, `trocar.stage.needles[0].tip.z > ${out} + 0.005`)
    await first.mouse.up()
    assert.deepEqual(await first.evaluate('trocar.drive.command()'), [0, 0, 0, 0, 0, 0])
  })

  await check('ten minutes take no more memory than one', async () => {
    const held = await first.evaluate(async () => {
      const kept = new trocar.history.constructor(true), { membranes } = trocar.stage.scene, sizes = []
      const sample = { values: Array(11).fill(0), membrane: 0, events: 0b111 } // the event bits are touch, puncture and contact
      for (let k = 1; k <= 60000; k++) {
        kept.addSamples([{ ...sample, time: k / 100, events: k % 50 ? 0 : sample.events }], membranes)
        if (k % 3 === 0) kept.addPicture({ time: k / 100, bytes: 4096 })
        if (k % 6000) continue
        sizes.push([kept.pictures.length, kept.bytes, kept.marks.length, kept.columns[0].length])
        await new Promise((done) => setTimeout(done)) // lets the page respond to the server, so that it keeps the needle
      }
      return sizes
    })
    assert.equal(held.length, 10)
    for (const size of held.slice(1)) size.forEach((value, i) => assert(value <= 1.02 * held[1][i], `${held}`))
  })

  await driven('further pictures and cuts take no more graphics memory than the first', first, async () => {
    await first.selectOption('#cut-axis', 'x')
    await until(first, '!trocar.stage.dirty')
    const { group, ends } = await first.evaluate('({ group: trocar.stage.tracks.group.visible, ends: trocar.stage.tracks.ends.count })')
    assert(group && ends > 6, 'a track is among what is drawn')
    await first.evaluate(() => {
      trocar.made = 0
      for (const { renderer } of [trocar.stage, trocar.echo]) {
        const graphics = renderer.getContext(), make = graphics.createBuffer.bind(graphics)
        graphics.createBuffer = () => { trocar.made++; return make() }
      }
    })
    const held = await first.evaluate(graphicsHeld), before = await first.evaluate('trocar.stage.renderer.info.render.frame')
    await first.keyboard.down('a') // the roll has no limit
    await until(first, `trocar.stage.renderer.info.render.frame > ${before + 20}`)
    await first.keyboard.up('a')
    assert.equal(await first.evaluate('trocar.made'), 0)
    for (const axis of ['y', 'x', 'y', 'x']) {
      await first.selectOption('#cut-axis', axis)
      await until(first, '!trocar.stage.dirty')
    }
    assert.deepEqual(await first.evaluate(graphicsHeld), held)
  })

  for (const [width, height] of SIZES)
    await driven(`layout while the needle is driven, ${width} x ${height}`, first, async () => {
      await first.setViewportSize({ width, height })
      await first.waitForTimeout(300)
      await checkLayout(first, `${width} x ${height}`)
      assert.deepEqual(await first.evaluate(`(${touchingLabels})()`), [], `${width} x ${height}`)
    })
  await first.click('#take')
  await until(first, '!trocar.status.drives')
  for (const [width, height] of SIZES.slice(0, 2))
    await check(`layout after the needle was let go, ${width} x ${height}`, async () => {
      await first.setViewportSize({ width, height })
      await first.evaluate('trocar.drive.lost = "The needle was let go: the connection ended."')
      await until(first, '/let go/.test(document.getElementById("drive-note").textContent)')
      await first.waitForTimeout(300)
      await checkLayout(first, `let go, ${width} x ${height}`)
    })
  await first.setViewportSize({ width: 1000, height: 640 })

  await driven('a needle is not driven by old pictures, and what is said of it moves no button', first, async () => {
    const base = () => first.evaluate('[...trocar.history.pictures.at(-1).needles[0].joints.slice(0, 3)]'), reset = async () => (await first.locator('#reset').boundingBox()).y
    const place = await reset()
    await first.evaluate('trocar.drawn = trocar.stage.finished; trocar.stage.finished = () => false') // makes the page believe that drawing never finishes
    const seen = await first.evaluate('[...trocar.shown.needles[0].joints.slice(0, 3)]')
    await first.keyboard.down('s')
    try {
      await until(first, '/late/.test(document.getElementById("link").textContent) && /mm\\/s at most/.test(document.getElementById("drive-note").textContent)')
      assert.equal(await reset(), place)
      await until(first, '/held still/.test(document.getElementById("drive-note").textContent) && trocar.drive.command()[2] === 0')
      assert.equal(await reset(), place)
      await first.waitForTimeout(500)
      const moved = Math.hypot(...(await base()).map((value, i) => value - seen[i]))
      assert(moved > 1e-3 && moved < 0.027, `${moved} m further than is seen`)
      await first.waitForTimeout(1000)
      assert(Math.abs(Math.hypot(...(await base()).map((value, i) => value - seen[i])) - moved) < 1e-4, 'it stands')
    } finally {
      await first.keyboard.up('s')
      await first.evaluate('trocar.stage.finished = trocar.drawn')
    }
    await until(first, 'trocar.state.name === "live" && trocar.drive.age.at(performance.now()) < 1')
  })

  await driven('Reset must be held down', first, async () => {
    const deep = await tip(first), [reset] = [first.locator('#reset')]
    await reset.click()
    await first.waitForTimeout(1000)
    assert(Math.abs(await tip(first) - deep) < 1e-3)
    await reset.hover()
    await first.mouse.down()
    await until(first, 'trocar.stage.needles[0].tip.z < 0')
    await first.mouse.up()
  })

  await check('the needle is released with its browser', async () => {
    await second.setViewportSize({ width: 700, height: 900 })
    await first.context().close()
    await until(second, '!trocar.status.driven && trocar.status.owned === "nobody"')
    await until(second, '!document.getElementById("take").disabled')
  })

  await check('when the server dies the needle is released, and the next server is driven only on request', async () => {
    await second.click('#take')
    await until(second, 'trocar.status.drives && trocar.status.owned === "here"')
    await second.keyboard.down('w')
    await until(second, 'trocar.history.columns[7][trocar.history.count - 1] > 0.01')
    await stop(server, 'SIGKILL')
    await until(second, `${badge('no server')} && ${banner('Last data')} && !trocar.status.drives && document.getElementById('controls').hidden`)
    await until(second, `getComputedStyle(document.getElementById('view')).opacity === '0.4'`)
    const [count, died] = await second.evaluate('[trocar.history.count, trocar.history.end]')
    server = await startServer()
    await until(second, `${badge('live')} && trocar.history.count > ${count} + 50`) // meanwhile, the key is still held down
    assert.deepEqual(await second.evaluate('[trocar.status.drives, trocar.status.owned, trocar.drive.command()]'), [false, 'nobody', [0, 0, 0, 0, 0, 0]])
    const since = await second.evaluate(`Array.from(trocar.history.columns[7].subarray(${count}, trocar.history.count))`)
    assert(since.every((depth) => depth === 0), 'the needle of the new server is outside')
    assert(await tip(second) < 0, 'and is shown outside')
    await second.keyboard.up('w')
    const back = await second.evaluate(`trocar.history.columns[0][${count}]`)
    assert(back - died > 0.5)
    await second.selectOption('#window', '60')
    await second.waitForTimeout(500) // plots are redrawn less often than the view
    const end = await second.evaluate('trocar.history.end')
    const drawn = await second.evaluate(forceDrawn, [died - 0.5, (died + back) / 2, (back + end) / 2])
    assert.deepEqual(drawn, [true, false, true], 'the plot has a gap')
    assert(/let go/.test(await second.textContent('#drive-note')))
  })

  await check('a trocar-view that does not answer is not live', async () => {
    view.kill('SIGSTOP')
    await until(second, `${badge('stale')} && ${banner('does not answer')}`)
    view.kill('SIGCONT')
    await until(second, badge('live'))
  })

  await check('a browser is told that all places are taken', async () => {
    const others = await Promise.all(Array.from({ length: 15 }, joinRaw))
    const third = await open()
    await until(third, `${badge('refused')} && ${banner('16 browsers are connected already')}`)
    for (const socket of others) socket.destroy()
    await until(third, badge('live'))
    await third.context().close()
  })

  await check('a restart of trocar-view is detected', async () => {
    const held = await second.evaluate(graphicsHeld)
    await stop(view, 'SIGKILL')
    await until(second, badge('no connection'))
    view = await start('clients/view/trocar-view')
    // nothing from the old scene may be left
    await until(second, `${badge('live')} && !trocar.stage.dirty && !trocar.echo.dirty && JSON.stringify(${graphicsHeld}) === '${JSON.stringify(held)}'`)
  })

  await check('another site is refused', async () => {
    const other = await (await browser.newContext()).newPage()
    const opened = await other.evaluate((address) => new Promise((done) => {
      const socket = new WebSocket(address, 'trocar-view')
      socket.onopen = () => done(true)
      socket.onerror = () => done(false)
    }), ADDRESS.replace('http', 'ws'))
    assert.equal(opened, false)
  })
  await check('of two needles each is driven, shown and plotted', async () => {
    await stop(view)
    await stop(server)
    await second.setViewportSize(SMALL)
    const two = path.join(process.argv[4], 'two.yaml'), text = await readFile(scene, 'latin1')
    const posed = 'start: {position: [0, 0.06, -0.193], orientation: [0.9887710779360423, 0.1494381324735992, 0, 0]}' // tilted by 0.3 rad about x
    const placed = text.replace(/^mesh: */m, `mesh: ${path.dirname(scene)}/`).replace(/start: *{[^}]*}/, posed).replace(/^patient_to_mesh:[^\]]*\]/m, '')
    await writeFile(two, `${placed}\nneedles: 2\npatient_to_mesh: [-1.0e-3, 0, 0, 0.01, 0, 1.0e-3, 0, 0.02, 0, 0, -1.0e-3, 0.03, 0, 0, 0, 1]\n`)
    server = await start('server/trocar-server', '--allow-non-rt', '--scene', two)
    view = await start('clients/view/trocar-view', '--scene', two)
    await until(second, `${badge('live')} && !document.getElementById('needle-choice').hidden`)
    const depth = 'trocar.history.columns[7][trocar.history.count - 1]', drawn = 'trocar.stage.needles.map(({ group }) => group.visible)'
    const take = async (needle) => {
      await second.selectOption('#needle', `${needle}`)
      await until(second, '!document.getElementById("take").disabled')
      await second.click('#take')
      await until(second, `trocar.status.drives && trocar.status.owned === "here" && trocar.shown?.needles[${needle}]`)
      await until(second, 'document.getElementById("needle").disabled') // the selection is locked: the driven needle stays selected
    }
    const push = async () => {
      await second.keyboard.down('w')
      await until(second, `${depth} > 0.02`)
      await second.keyboard.up('w')
      await second.click('#take')
      await until(second, '!trocar.status.drives && trocar.status.owned === "nobody"')
    }
    await take(1)
    await push()
    assert.deepEqual(await second.evaluate(drawn), [false, true], 'the other one has not been held yet')
    await take(0)
    assert.deepEqual(await second.evaluate(drawn), [true, true])
    // plots and readouts show the selected needle
    await until(second, `${depth} === 0 && parseFloat(document.getElementById("depth").textContent) === 0`)
    await push()
    const [one, other] = await second.evaluate('trocar.shown.needles.map(({ contacts, joints }) => ({ contacts: contacts.length / 9, x: joints[0] }))')
    assert(one.contacts > 1 && other.contacts > 1, 'each with its contacts')
    assert(Math.abs(other.x - one.x - 0.01) < 1e-3, 'side by side')
    const placeShown = (text, [x, y, z]) => { // waits until the needle has come to rest and the text shows its position
      const expected = [(0.01 - x) * 1e3, (y - 0.02) * 1e3, (0.03 - z) * 1e3], found = /^([LR]) ([\d.]+) {2}([AP]) ([\d.]+) {2}([SI]) ([\d.]+) mm$/.exec(text)
      return found !== null && expected.every((value, i) => found[2 * i + 1] === ['LR', 'PA', 'SI'][i][value < 0 ? 1 : 0] && Math.abs(found[2 * i + 2] - Math.abs(value)) < 0.06)
    }
    await until(second, `(${placeShown})(document.getElementById('tip').textContent, trocar.stage.needles[0].tip.toArray())`)
    const [[x0, y0, z0], [x1, y1, z1]] = await second.evaluate('(({ joints }) => [[...joints.slice(0, 3)], [...joints.slice(3, 6)]])(trocar.shown.needles[0])')
    assert(Math.abs(Math.atan2(y0 - y1, z1 - z0) - 0.3) < 0.01 && Math.abs(x1 - x0) < 1e-3, 'in the direction of the start')
    assert(await second.evaluate('trocar.history.tracks.every(({ marks }) => marks.some(({ name }) => name === "skin"))'), 'each with its punctures')
    await second.selectOption('#needle', '1')
    for (const driven of [false, true]) {
      if (driven) await take(1)
      for (const [width, height] of [[390, 844], [844, 390], [1024, 768]]) {
        await second.setViewportSize({ width, height })
        await second.waitForTimeout(300)
        await checkLayout(second, `two needles, ${driven ? 'one driven, ' : ''}${width} x ${height}`)
        await shoot(second, `two-needles-${driven ? 'driven-' : ''}${width}`)
      }
    }
  })
  assert.deepEqual(faults, [])
  await second.context().close()
} finally {
  await stop(server)
  await stop(view)
  await browser.close()
}

/** Acts as a browser that acknowledges every update, using a raw socket. */
async function joinRaw() {
  const { host, hostname, port, origin } = new URL(ADDRESS), socket = connect(port, hostname), answer = Buffer.alloc(38)
  answer.set([0x82, 0x80 | 32, 0, 0, 0, 0, 1]) // acknowledges the update; the frame is masked with zeros
  socket.write(`GET / HTTP/1.1\r\nHost: ${host}\r\nOrigin: ${origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: trocar-view\r\n\r\n`)
  await once(socket, 'data')
  socket.on('data', () => socket.write(answer))
  socket.on('error', () => {})
  return socket
}

/** Runs in the page. Returns whether the curve of the force along z is drawn at each of the times (s). */
function forceDrawn(times) {
  const { chart, colours } = trocar.plots.plots[0], { top, height } = chart.bbox
  const wanted = [1, 3, 5].map((at) => parseInt(colours[2].slice(at, at + 2), 16))
  return times.map((time) => {
    const pixels = chart.ctx.getImageData(Math.round(chart.valToPos(time, 'x', true)), top, 1, height).data
    for (let i = 0; i < pixels.length; i += 4) if (wanted.every((value, k) => Math.abs(pixels[i + k] - value) < 40)) return true
    return false
  })
}

/** Runs in the page. Returns the plots that are too low to be read, or whose labels (10 px) touch. */
function touchingLabels() {
  return trocar.plots.plots.filter(({ holder }) => holder.clientHeight > 0).flatMap(({ title, chart }) => {
    const [, { _splits: splits, _values: words }] = chart.axes, height = chart.over.clientHeight
    const places = splits.filter((_, i) => words[i] !== null && words[i] !== '').map((value) => chart.valToPos(value, 'y')).sort((a, b) => a - b)
    const close = places.some((place, i) => i > 0 && place - places[i - 1] < 11)
    return [...(close ? [`${title}: labels at ${places.map(Math.round)}`] : []), ...(height < 30 ? [`${title}: ${height} px high`] : [])]
  })
}
