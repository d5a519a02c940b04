/* Tests the computed ultrasound images with a live server: they arrive, the knobs change them, they show the needle, and they tilt when the probe turns. Run
   by test_view.sh in a private network.
   usage: ultrasound_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import path from 'node:path'
import { browser, check, checkLayout, driven, faults, open, pressUntil, shoot as shootPage, until } from './page.mjs'
import { source, start, stop } from './parts.mjs'

const trus = path.join(source, 'meshes/trus.yaml')
const SLICES = { axial: 'trocar.echo', sagittal: 'trocar.procedure.sagittal' }
let shots = 0
const shoot = (name) => shootPage(page, `ultrasound-${++shots}-${name}`)

/** Returns the mean brightness of a canvas's pixels, leaving out those outside the ultrasound image. */
const brightness = (slice) => page.evaluate((slice) => {
  slice = slice.split('.').slice(1).reduce((at, name) => at[name], trocar)
  slice.render(1)
  const { width, height } = slice.pixels, { data } = slice.pixels.getContext('2d').getImageData(0, 0, width, height)
  let sum = 0, count = 0
  for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 250) sum += data[i], count++
  return sum / count
}, slice)

const set = (id, value) => page.evaluate(([id, value]) => {
  const knob = document.getElementById(id)
  if (typeof value === 'boolean') knob.checked = value
  else knob.value = value
  knob.dispatchEvent(new Event('input'))
}, [id, value])

const press = (key, done) => pressUntil(page, key, done)

const view = await start('clients/view/trocar-view', '--scene', trus)
let server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', trus)
  page = await open({ width: 1280, height: 800 })

  await check('both images are computed at the probe, and shown instead of the illustration', async () => {
    for (const slice of Object.values(SLICES)) await until(page, `${slice}.simulated && ${slice}.illustrated === false`)
    const origin = await page.evaluate('trocar.echo.image.origin')
    assert(Math.abs(origin[2] - 0.061) < 1e-6 && Math.abs(origin[1] + 0.032) < 1e-6, `${origin}`)
    await shoot('start')
  })

  await check('gain, dynamic range and depth change the image', async () => {
    const plain = await brightness(SLICES.axial)
    assert(plain > 40 && plain < 200, `${plain}`)
    await set('scan-gain', 10)
    const loud = await brightness(SLICES.axial)
    assert(Math.abs(loud - plain - 255 * 10 / 60) < 8, `${plain} ${loud}`)
    await set('scan-gain', 0)
    await set('scan-range', 90)
    assert(await brightness(SLICES.axial) > plain + 10)
    await set('scan-range', 60)
    const height = await page.evaluate('trocar.echo.image.height * trocar.echo.image.pixel')
    await set('scan-depth', '0.03')
    await until(page, `trocar.echo.image.height * trocar.echo.image.pixel < ${0.8 * height} && trocar.procedure.sagittal.image.height * trocar.echo.image.pixel < 0.035`)
    await set('scan-depth', '0')
    await until(page, `Math.abs(trocar.echo.image.height * trocar.echo.image.pixel - ${height}) < 1e-9`)
    await set('scan-marks', false)
    assert.equal(await page.evaluate('trocar.echo.marked || trocar.procedure.sagittal.marked'), false)
    await shoot('without-marks')
    await set('scan-marks', true)
  })

  await check('the knobs fit on the page', async () => {
    await page.click('#scan summary')
    await checkLayout(page, 'the scanner')
    await shoot('knobs')
    await page.click('#scan summary')
  })

  await driven('both planes tilt when the probe turns', page, async () => {
    if (!await page.evaluate('trocar.probe.moving')) await page.keyboard.press('b')
    await until(page, 'trocar.probe.moving')
    await press('a', 'Math.abs(trocar.procedure.sagittal.image.up[0]) > 0.15')
    const [axial, sagittal] = await page.evaluate('[trocar.echo.image, trocar.procedure.sagittal.image]')
    assert(Math.abs(axial.normal[2] - 1) < 1e-6, 'the axial plane stays across the probe')
    assert(Math.abs(Math.abs(sagittal.normal[0]) - Math.cos(Math.asin(sagittal.up[0]))) < 1e-6, 'the sagittal plane turns about the probe')
    await until(page, 'trocar.procedure.sagittal.simulated && /tilted by/.test(trocar.procedure.sagittal.tilt())')
    await shoot('tilted')
  })

  await check('a past moment is shown as an illustration', async () => {
    await page.evaluate('trocar.seek(trocar.history.end - 1)')
    await until(page, '!trocar.echo.simulated && trocar.echo.illustrated')
    await page.evaluate('trocar.goLive()')
    await until(page, 'trocar.echo.simulated && !trocar.echo.illustrated')
  })
  assert.deepEqual(faults, [])
} finally {
  await browser.close()
  await stop(server)
  await stop(view)
}
console.log('passed')
