/* Tests recorded insertions in the page and as pictures, in headless Chromium. Run by test_view.sh in a private network.
   usage: log_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import { once } from 'node:events'
import { readFile } from 'node:fs/promises'
import path from 'node:path'
import { browser, check, checkInView, checkLayout, faults, open, until } from './page.mjs'
import { run, scene, source, start, stop } from './parts.mjs'

const out = process.argv[4]
const LOG = path.join(source, 'tests/traces/figure8.log')
const SIZES = [[390, 844], [1440, 900], [1920, 1080]] // only a few; live_test.mjs checks more sizes

const MOMENTS = [ // name, time (s), direction of the cut, and condition for what must be visible
  ['before', 0.05, '', ({ contacts, track }) => contacts === 0 && track === 0],
  ['deep', 1.3, 'x', ({ depth, gland, track, offTip }) => depth > 0.06 && gland > 5e-5 && track > 10 && offTip < 2e-3], // the track ends at the tip
  ['retraction', 1.47, 'x', ({ force, contacts, sticking, gland }) => force > 0.3 && sticking > contacts / 2 && gland < -2e-5],
]

const AT_REST = '!trocar.stage.dirty && !trocar.stage.coarse && trocar.stage.finished() && !trocar.echo.dirty'

const player = await start('clients/view/trocar-view', '--log', LOG)
try {
  const page = await open({ width: 1440, height: 900 }), whole = 'trocar.history.pictures.length > 0 && trocar.history.end >= trocar.status.now - 0.011'
  await until(page, whole)
  for (const [name, time, cut, seen] of MOMENTS) {
    await page.evaluate(`trocar.setCut('${cut}', 0.55); trocar.seek(${time})`)
    await until(page, `Math.abs(trocar.shown?.time - ${time}) < 0.05 && ${AT_REST}`)
    const scenery = await page.evaluate(sceneryShown)
    assert(seen(scenery), `${name}: ${JSON.stringify(scenery)}`)
    assert.deepEqual(await page.evaluate(coloursOfCut), await page.evaluate(`trocar.stage.recut(), (${coloursOfCut})()`), 'the cut has the colours of the legend')
    await page.waitForTimeout(300) // plots are redrawn less often than the view
    await until(page, AT_REST)
    await page.screenshot({ path: path.join(out, `${name}.png`) })
    console.log(`ok picture ${name}`)
  }
  await check('the pictures match the stored ones', async () => {
    for (const [name] of MOMENTS) {
      const difference = await page.evaluate(compareImages, [await read(path.join(out, `${name}.png`)), await read(path.join(source, 'clients/view/pictures', `${name}.png`))])
      console.log(`   ${name}: mean difference ${difference.mean.toFixed(2)} of 255, ${(100 * difference.far).toFixed(2)} % of pixels far off`)
      assert(difference.mean < 1.5 && difference.far < 0.006, `${name} differs: ${JSON.stringify(difference)}; see ${out}`)
    }
  })

  await check('the picture button saves the view and the slice', async () => {
    const [file] = await Promise.all([page.waitForEvent('download'), page.click('#screenshot')])
    await file.saveAs(path.join(out, 'button.png'))
    const saved = await page.evaluate(partsOf, await read(path.join(out, 'button.png')))
    assert(saved.height === 1000 && saved.width > 1400, JSON.stringify(saved))
    assert(saved.slice > 25 && saved.stage > 10, JSON.stringify(saved)) // if the slice is not drawn, its area has a brightness of 6
    await until(page, `trocar.stage.canvas.width / trocar.stage.canvas.height - trocar.stage.canvas.clientWidth / trocar.stage.canvas.clientHeight < 0.01`)
  })

  await check('--png: size, view, cut and theme', async () => {
    const taken = {}, file = (name) => path.join(out, `png-${name}.png`)
    for (const [name, ...options] of [['plain'], ['cut', '--cut', 'sagittal'], ['small', '--size', '640x900', '--view', 'side', '--cut', 'axial:40', '--theme', 'dark']]) {
      const child = run('clients/view/trocar-view', '--scene', scene, '--log', LOG, '--at', '1.3', '--png', file(name), ...options)
      if (child.exitCode === null) await once(child, 'exit')
      assert.equal(child.exitCode, 0)
      taken[name] = await page.evaluate(partsOf, await read(file(name)))
    }
    const { plain, cut, small } = taken, said = JSON.stringify(taken)
    assert.deepEqual([plain, cut, small].map(({ width, height }) => [width, height]), [[1600, 1000], [1600, 1000], [640, 900]])
    assert(plain.slice > 25 && cut.slice === plain.slice && small.below > 25, said)
    assert(plain.ground > 200 && cut.ground > 200 && small.ground < 40, said)
    assert((await page.evaluate(compareImages, [await read(file('plain')), await read(file('cut'))])).mean > 3, 'the cut is visible')
  })

  for (const [width, height] of SIZES)
    await check(`layout of a log at ${width} x ${height}`, async () => {
      await page.setViewportSize({ width, height })
      await page.waitForTimeout(300)
      await checkLayout(page, `${width} x ${height}`)
    })
  for (const [width, height] of [...SIZES, [844, 390]])
    await check(`layout of the list of keys at ${width} x ${height}`, async () => {
      await page.setViewportSize({ width, height })
      await page.click('#help')
      await checkInView(page, '#keys-title, #keys button', 'the list begins at its top')
      await checkLayout(page, 'keys')
      await page.keyboard.press('End')
      await until(page, `(({ scrollTop, clientHeight, scrollHeight }) => scrollTop + clientHeight >= scrollHeight - 1)(document.getElementById('keys'))`)
      await checkInView(page, '#keys button, #keys dd:last-of-type', 'its end can be reached, and it can be closed from there')
      await page.keyboard.press('Escape')
    })
  assert.deepEqual(faults, [])
} finally {
  await stop(player)
  await browser.close()
}

/** Runs in the page. Returns depth (m), force along z (N), number of contacts, number of sticking contacts, mean displacement of the gland along z (m),
   number of ends of the track lines, and distance of the last end from the tip (m). */
function sceneryShown() {
  const { shown, history, stage: { scene } } = trocar, at = history.sampleIndex(shown.time), gland = new Set()
  const { group } = scene.regions.find(({ name }) => name === 'prostate'), states = shown.needles[0].contacts.filter((value, i) => i % 9 === 7)
  for (let t = 0; t < scene.tets.length; t += 5) if (scene.tets[t] === group) scene.tets.subarray(t + 1, t + 5).forEach((node) => gland.add(node))
  const along = [...gland].map((node) => shown.scale * shown.displacement[3 * node + 2])
  const { array, count } = trocar.stage.tracks.ends, ends = array.subarray(0, count), tip = shown.needles[0].joints.slice(-3)
  return { track: ends.length / 3, offTip: Math.hypot(...tip.map((x, i) => x - ends.at(i - 3))),
           depth: history.columns[7][at], force: history.columns[3][at], contacts: states.length, sticking: states.filter((state) => state === 0).length,
           gland: along.reduce((sum, z) => sum + z, 0) / along.length }
}

/** Runs in the page. Returns the colours of the cut surface. */
function coloursOfCut() {
  const { array, count } = trocar.stage.anatomy.cutTints
  return Array.from(array.subarray(0, count))
}

/** Runs in the page. Returns a picture's size, the mean brightness of its background and of its slice (both where the slice is beside the 3D view and where
   it is below), and the spread of the 3D view's brightness. */
async function partsOf(url) {
  const image = new Image()
  image.src = url
  await image.decode()
  const { width, height } = image, ink = new OffscreenCanvas(width, height).getContext('2d')
  ink.drawImage(image, 0, 0)
  const values = (x, y, size) => ink.getImageData(x, y, size, size).data.filter((value, i) => i % 4 === 0), mean = (list) => list.reduce((sum, v) => sum + v, 0) / list.length
  const middle = values(Math.max(width / 2 - 400, 0), height / 4, Math.min(400, width / 2))
  const level = mean(middle), side = Math.min(0.45 * height, 0.34 * width)
  return { width, height, ground: mean(values(2, 2, 8)), slice: mean(values(width - 0.55 * side - 50, 0.45 * side, 100)), below: mean(values(0.74 * width - 30, height - 0.3 * width, 60)),
           stage: Math.sqrt(mean(middle.map((v) => (v - level) ** 2))) }
}

async function read(file) {
  return `data:image/png;base64,${(await readFile(file)).toString('base64')}`
}

/** Runs in the page. Returns the mean difference per channel, and the fraction of pixels that differ by more than 40. */
async function compareImages(urls) {
  const pixels = await Promise.all(urls.map(async (url) => {
    const image = new Image()
    image.src = url
    await image.decode()
    const canvas = new OffscreenCanvas(image.width, image.height), ink = canvas.getContext('2d')
    ink.drawImage(image, 0, 0)
    return ink.getImageData(0, 0, image.width, image.height).data
  }))
  if (pixels[0].length !== pixels[1].length) return { mean: 255, far: 1 }
  let sum = 0, far = 0
  for (let i = 0; i < pixels[0].length; i += 4) {
    const off = [0, 1, 2].map((k) => Math.abs(pixels[0][i + k] - pixels[1][i + k]))
    sum += off[0] + off[1] + off[2]
    far += Math.max(...off) > 40
  }
  return { mean: sum / (0.75 * pixels[0].length), far: far / (pixels[0].length / 4) }
}
