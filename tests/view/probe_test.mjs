/* Tests the ultrasound probe with a live server: it is shown where the scene puts it, is moved with the keys, presses on the rectum's wall, and takes the
   images with it. Run by test_view.sh in a private network.
   usage: probe_test.mjs BUILD_DIR SOURCE_DIR OUT_DIR */
import assert from 'node:assert/strict'
import path from 'node:path'
import { browser, check, checkLayout, driven, faults, open, pressUntil, shoot, until } from './page.mjs'
import { source, start, stop } from './parts.mjs'

const trus = path.join(source, 'meshes/trus.yaml')
const words = () => page.evaluate("document.getElementById('probe-force').textContent")
const probe = () => page.evaluate('trocar.shown.probe && { y: trocar.shown.probe.position[1], z: trocar.shown.probe.position[2], force: [...trocar.shown.probe.force] }')

const press = (key, done) => pressUntil(page, key, done)

const view = await start('clients/view/trocar-view', '--scene', trus)
let server, page
try {
  server = await start('server/trocar-server', '--allow-non-rt', '--scene', trus)
  page = await open({ width: 1000, height: 700 })

  await check('the probe rests at the scene\'s place, before any needle has been held', async () => {
    await until(page, 'trocar.shown?.probe && trocar.state.name === "live"')
    const { y, z } = await probe()
    assert(Math.abs(y + 0.032) < 1e-6 && Math.abs(z + 0.08) < 1e-6, `${[y, z]}`)
    assert.equal(await words(), 'Probe: no contact')
    assert(await page.evaluate('trocar.probe.body.visible && document.getElementById("move-probe").getClientRects().length === 0'))
  })

  await driven('the keys move it after B, and the needle stays', page, async () => {
    await page.keyboard.press('b')
    await until(page, 'trocar.probe.moving')
    const needle = await page.evaluate('[...trocar.shown.needles[0]?.joints ?? [0, 0, 0]].slice(0, 3)')
    await press('ArrowUp', 'trocar.shown.probe.position[1] > -0.029')
    await press('w', 'trocar.shown.probe.position[2] > -0.076')
    await until(page, 'trocar.shown.probe.contacts > 5')
    assert.match(await words(), /^Probe: \d+\.\d\d N, pressing \d+ points$/)
    const { y, z, force } = await probe()
    assert(force[1] < -2 && y > -0.029 && z > -0.076, `${force} N at ${[y, z]}`)
    const after = await page.evaluate('[...trocar.shown.needles[0].joints].slice(0, 3)')
    if (needle.some(Boolean)) assert(after.every((x, i) => Math.abs(x - needle[i]) < 1e-6), `${needle} ${after}`)
  })

  await check('the images go with it', async () => {
    const [axial, plane, fan, sagittal] = await page.evaluate(`[trocar.echo.place, trocar.probe.place(trocar.shown.probe).toArray(), trocar.echo.tissue.material.uniforms.probe.value.toArray(),
      trocar.procedure.sagittal.place]`)
    assert(Math.abs(axial - plane[2]) < 1e-3 && Math.abs(fan[1] - plane[1]) < 1e-3 && Math.abs(sagittal - plane[0]) < 1e-3, `${[axial, plane, fan, sagittal]}`)
    assert.equal(await page.evaluate('document.getElementById("follow").checked'), false)
  })

  await driven('it says where the tissue stops it', page, async () => {
    if (!await page.evaluate('trocar.probe.moving')) await page.keyboard.press('b')
    await until(page, 'trocar.probe.moving')
    await press('ArrowUp', 'trocar.shown.probe.stopped')
    assert.match(await words(), /^Probe: 3\d\.\d\d N, pressing \d+ points\. The tissue stops it: draw it back$/)
    await press('ArrowDown', '!trocar.shown.probe.stopped')
  })

  await driven('B gives the keys back to the needle', page, async () => {
    if (await page.evaluate('trocar.probe.moving')) {
      await page.keyboard.down('a')
      await page.keyboard.press('b')
      assert(await page.evaluate('!trocar.probe.moving && trocar.drive.command().every((x) => x === 0)'), 'a held key moves the needle')
      await page.keyboard.up('a')
    }
    const { z } = await probe()
    const start = await page.evaluate('trocar.shown.needles[0].joints[2]')
    await press('s', `trocar.shown.needles[0].joints[2] < ${start - 1e-3}`)
    assert(Math.abs((await probe()).z - z) < 1e-3)
    await shoot(page, 'probe')
    await checkLayout(page, 'the probe while driving')
  })
  assert.deepEqual(faults, [])
} finally {
  await browser.close()
  await stop(server)
  await stop(view)
}
console.log('passed')
